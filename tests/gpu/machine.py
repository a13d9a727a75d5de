"""The machine: processor, drivers, versions, and what the package finds of them."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from dappo_batch import devices, machine
from dappo_batch._core import ConfigError, gpu_device

__all__ = ["describe", "vulkan_driver"]

_PACKAGES = ("dappo-batch", "mujoco", "mujoco-warp", "warp-lang", "numpy", "torch", "jax")
_DRIVERS = tuple(
    Path(folder, "vulkan/icd.d/nvidia_icd.json")
    for folder in ("/usr/local/nvidia/share", "/usr/share", "/usr/local/share", "/etc")
)
_VARIABLES = ("VK_DRIVER_FILES", "NVIDIA_DRIVER_CAPABILITIES", "DAPPO_GPU_SOFTWARE", "CUDA_VISIBLE_DEVICES")
_QUERY = "name,driver_version,memory.total,compute_cap,clocks.max.sm,power.limit"


def vulkan_driver() -> dict[str, str]:
    """Return the environment in which Vulkan finds NVIDIA's driver, wherever a container keeps it."""
    if os.environ.get("VK_DRIVER_FILES"):
        return {}
    return next(({"VK_DRIVER_FILES": str(path)} for path in _DRIVERS if path.is_file()), {})


def describe() -> Iterator[dict[str, Any]]:
    """Yield what is there; the last row is ``ok`` if the package can use a GPU."""
    yield machine.describe()
    yield {name: _version(name) for name in _PACKAGES}
    yield {name: os.environ.get(name, "") for name in _VARIABLES}
    yield {
        "nvidia-smi": _answer("nvidia-smi", f"--query-gpu={_QUERY}", "--format=csv,noheader"),
        "nvcc": _answer("nvcc", "--version"),
    }
    cuda = devices.problem("cuda")
    try:
        engine = gpu_device()
    except ConfigError as error:
        yield {"ok": not cuda, "gpu": str(error), "cuda": cuda or "usable"}
    else:
        yield {"gpu": engine, "cuda": cuda or "usable"}


def _version(package: str) -> str | None:
    try:
        return version(package)
    except PackageNotFoundError:
        return None


def _answer(*command: str) -> str | None:
    """Return the last line that a command prints; ``None`` if it is not installed."""
    if shutil.which(command[0]) is None:
        return None
    done = subprocess.run(command, capture_output=True, text=True, timeout=20, check=False)
    return ((done.stdout + done.stderr).strip().splitlines() or [""])[-1]
