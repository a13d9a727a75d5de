"""Devices of the backend ``warp``: availability, start of the kernels, and messages for their errors.

Warp is imported only here and only on demand, as it belongs to the extra ``gpu``.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.util
import os
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from dappo_batch._core import ConfigError, DappoError

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from dappo_batch.kernels.engine import Engine
    from dappo_batch.kernels.stepper import Stepper
    from dappo_batch.model import ClassTable

__all__ = ["explain", "load_warp", "open_engine", "open_stepper", "problem", "report", "resolve"]

_INSTALL = "pip install dappo-batch[gpu]"
_NAMES = {"cuda": "cuda:0", "warp-cpu": "cpu"}
"""Warp's names of the devices."""


def resolve(device: str) -> str:
    """Return the device to use on this machine.

    Parameters
    ----------
    device : {"auto", "cpu", "cuda", "warp-cpu"}
        ``"auto"`` is a CUDA GPU if one can be used, otherwise the CPU.

    Raises
    ------
    ConfigError
        If the device cannot be used; the message contains the reason and a remedy.
    """
    if device == "auto":
        return "cpu" if problem("cuda") else "cuda"
    if device in _NAMES and (reason := problem(device)):
        raise ConfigError(f"the device {device} cannot be used: {reason}")
    return device


def problem(device: str) -> str:
    """Return why the backend ``warp`` cannot use ``"cuda"`` or ``"warp-cpu"``; empty if it can."""
    missing = [name for name in ("warp", "mujoco_warp") if importlib.util.find_spec(name) is None]
    if missing:
        return f"the extra `gpu` is not installed ({' and '.join(missing)} missing); {_INSTALL}"
    if device == "warp-cpu":
        return ""
    if not _has_driver():
        return "there is no NVIDIA driver; without a GPU, train with --device cpu"
    warp = load_warp()
    driver, needed = warp.get_cuda_driver_version(), _needed_driver(warp)
    if driver is not None and needed is not None and driver < needed:
        return (
            f"the NVIDIA driver is too old: it is one for CUDA {driver[0]}.{driver[1]}, and Warp"
            f" {warp.__version__} needs one for CUDA {needed[0]}.{needed[1]} (R580 or newer for CUDA 13);"
            " update the driver, or train with --device cpu"
        )
    if not warp.is_cuda_available():
        return "the NVIDIA driver finds no GPU; train with --device cpu"
    return ""


def report() -> str:
    """Return the versions of Warp, its CUDA and the driver's, and the devices it finds, in one line."""
    warp = load_warp()
    toolkit, driver = warp.get_cuda_toolkit_version(), warp.get_cuda_driver_version()
    parts = [f"Warp {warp.__version__}"]
    for name, known in (("built with CUDA", toolkit), ("driver for CUDA", driver)):
        if known is not None:
            parts.append(f"{name} {known[0]}.{known[1]}")
    parts += [f"{device.alias} {device.name}" for device in warp.get_devices()]
    return ", ".join(parts)


def open_engine(
    table: ClassTable,
    keys: NDArray[np.uint64],
    *,
    device: str,
    reward: str | None,
    **options: Any,  # noqa: ANN401 - of another function
) -> Engine:
    """Return the rollout engine of a robot.

    Parameters
    ----------
    table : ClassTable
        The robot.
    keys : array of shape [N]
        Random keys of the envs.
    device : {"cuda", "warp-cpu"}
        The device.
    reward : str, optional
        Name of the reward; by default that of the robot TOML.
    **options
        As for `dappo_batch.kernels.engine.Engine`.
    """
    resolve(device)
    from dappo_batch.kernels.engine import Engine
    from dappo_batch.kernels.task import Task

    with _compilation_notice(device):
        return Engine(Task.of(table, reward), keys, device=_NAMES[device], **options)


def open_stepper(
    table: ClassTable,
    num_envs: int,
    *,
    device: str,
    reward: str | None,
    **options: Any,  # noqa: ANN401 - of another function
) -> Stepper:
    """Return a robot's `Stepper`, one call for each env step; parameters as for `open_engine`."""
    resolve(device)
    from dappo_batch.kernels.stepper import Stepper
    from dappo_batch.kernels.task import Task

    with _compilation_notice(device):
        return Stepper(Task.of(table, reward), num_envs, device=_NAMES[device], **options)


def explain(error: BaseException) -> str:
    """Return the message for an exception of Warp or of the kernels, with a remedy."""
    text = str(error)
    if isinstance(error, DappoError):
        return text
    if type(error).__name__ == "PhysicsOverflowError":
        sizes: dict[str, int] = getattr(error, "sizes", {})
        if not sizes:
            return f"{text}; --device cpu simulates every robot"
        flags = " ".join(f"--{name} {2 * size}" for name, size in sizes.items())
        arguments = ", ".join(f"{name}={2 * size}" for name, size in sizes.items())
        return f"{text}; raise the sizes, for example {flags}, or {arguments} in Python"
    if isinstance(error, MemoryError) or "Failed to allocate" in text:
        return f"the device has too little memory: {text}; use fewer envs (--envs)"
    if isinstance(error, FloatingPointError):
        return f"the training has diverged: {text}; try a smaller ppo.learning_rate"
    if isinstance(error, (NotImplementedError, ValueError)):
        return f"the backend warp failed: {text}; --device cpu simulates every robot"
    return f"{type(error).__name__}: {text}"


def load_warp() -> Any:  # noqa: ANN401 - an optional module
    """Import and initialise Warp, without its log of compiled modules."""
    import warp

    # Warp would print a line for each of fifty modules.
    warp.config.log_level = max(warp.config.log_level, warp.LOG_WARNING)
    warp.init()
    return warp


def _needed_driver(warp: Any) -> tuple[int, int] | None:  # noqa: ANN401
    """Return the CUDA version that the driver must support: the first of Warp's major version."""
    toolkit = warp.get_cuda_toolkit_version()
    return None if toolkit is None else (toolkit[0], 0)


def _has_driver() -> bool:
    """Return whether a CUDA driver is installed, without Warp, whose start takes seconds."""
    try:
        ctypes.CDLL(ctypes.util.find_library("cuda") or "libcuda.so.1")
    except OSError:
        return False
    return True


@contextmanager
def _compilation_notice(device: str) -> Iterator[None]:
    """Print a notice on standard error if kernels are compiled."""
    folder = Path(load_warp().config.kernel_cache_dir)
    before, done = _modules(folder), threading.Event()

    def watch() -> None:
        while not done.wait(0.5):
            if _modules(folder) - before:
                note = f"compiling the kernels for {device}, a minute or two; they are cached in {folder}"
                print(note, file=sys.stderr, flush=True)
                return

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        done.set()
        watcher.join()


def _modules(folder: Path) -> set[str]:
    return set(os.listdir(folder)) if folder.is_dir() else set()
