"""``dappo-batch doctor``: checks of the installation, and commands that install what is missing.

A missing extra is not a failure; only checks of the core, the simulation of damaged robots, can fail.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import importlib.metadata
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from json import dumps
from typing import Any, Literal

import numpy as np

from dappo_batch import devices
from dappo_batch._core import ConfigError, LaneWorlds, gpu_device
from dappo_batch.envs import make_vec
from dappo_batch.envs.options import Backend
from dappo_batch.machine import cores, cpu_flags, cpu_name
from dappo_batch.model import compile_class_table, mujoco_library
from dappo_batch.render import film, opengl

__all__ = ["Check", "command", "diagnose"]

Status = Literal["ok", "missing", "failed"]

_RENDER_TIMEOUT = 60.0  # s; without a GPU the first frame may compile shaders
_RENDER = """\
import mujoco
model = mujoco.MjModel.from_xml_string(
    "<mujoco><worldbody><light pos='0 0 3'/><geom type='sphere' size='1'/></worldbody></mujoco>"
)
data = mujoco.MjData(model)
mujoco.mj_forward(model, data)
renderer = mujoco.Renderer(model, 32, 32)
renderer.update_scene(data)
print("brightest pixel", int(renderer.render().max()), flush=True)
# Freeing some software renderers fails, which does not affect pictures.
import os
os._exit(0)
"""
_RENDERERS = opengl.INSTALL


@dataclass(frozen=True)
class _Extra:
    """An optional package, its purpose and the command that installs it."""

    package: str
    purpose: str
    install: str


_BACKENDS: tuple[Backend, ...] = ("mujoco", "lanes")
_EXTRAS = (
    _Extra("pillow", "pictures, animations and captions", "pip install pillow"),
    _Extra("av", "videos as mp4", "pip install av"),
    _Extra("mjviser", "robots in a browser: `dappo-batch view --browser`", "pip install mjviser"),
    _Extra("matplotlib", "figures of `dappo-batch report`", "pip install matplotlib"),
    _Extra("tensorboard", "watching a training run", "pip install tensorboard"),
    _Extra("wandb", "logging to Weights & Biases", "pip install wandb"),
    _Extra("stable-baselines3", "training with Stable-Baselines3", "pip install stable-baselines3"),
    _Extra("torch", "using the environments from PyTorch", "pip install torch"),
    _Extra("envpool", "another simulator in `dappo-batch bench`", "pip install envpool"),
)


@dataclass(frozen=True)
class Check:
    """The result of one check.

    Attributes
    ----------
    name : str
        Name of the check.
    status : {"ok", "missing", "failed"}
        ``missing`` is an optional part that is not installed; ``failed`` is an error.
    detail : str
        Version or other findings, or the error.
    cure : str
        A command or advice, if known.
    core : bool
        Whether the package cannot be used without it.
    """

    name: str
    status: Status
    detail: str
    cure: str = ""
    core: bool = False

    def as_dict(self) -> dict[str, Any]:
        """Return the check as a dictionary that can be written as JSON."""
        return {
            "status": self.status,
            "detail": self.detail,
            "cure": self.cure,
            "core": self.core,
        }


def _core(name: str, look: Callable[[], str], cure: str) -> Check:
    """Return a check of the core from a function that returns its findings or raises."""
    try:
        return Check(name, "ok", look(), core=True)
    except Exception as error:
        # Any exception is a finding and must not stop the other checks.
        return Check(name, "failed", f"{type(error).__name__}: {error}", cure, core=True)


def _library() -> str:
    path = mujoco_library.library_path()
    library = ctypes.CDLL(str(path))
    library.mj_versionString.restype = ctypes.c_char_p
    return f"{path} (MuJoCo {library.mj_versionString().decode()})"


def _version(package: str) -> str:
    return importlib.metadata.version(package)


def _self_test() -> str:
    """Compile the Ant's classes and simulate ten steps of four envs on each backend."""
    table = compile_class_table("ant")
    for backend in _BACKENDS:
        envs = make_vec(table, num_envs=4, seed=0, backend=backend)
        try:
            envs.reset(seed=0)
            rng = np.random.default_rng(0)
            for _ in range(10):
                obs, rewards, _, _, _ = envs.step(rng.uniform(-1.0, 1.0, envs.action_space.shape))
                if not (np.isfinite(obs).all() and np.isfinite(rewards).all()):
                    raise ArithmeticError(f"{backend}: an observation or a reward is not a finite number")
        finally:
            envs.close()
    simd = LaneWorlds(table, np.zeros(1, dtype=np.int64)).simd
    return (
        f"{len(table.models)} damage classes of the Ant compiled, 10 steps of 4 envs simulated with mujoco"
        f" and lanes ({simd})"
    )


def _core_checks() -> list[Check]:
    reinstall = "pip install --force-reinstall"
    return [
        _core("dappo-batch", lambda: _version("dappo-batch"), f"{reinstall} dappo-batch"),
        _core("mujoco", lambda: _version("mujoco"), f"{reinstall} mujoco"),
        _core("mujoco library", _library, f"{reinstall} mujoco"),
        _core("gymnasium", lambda: _version("gymnasium"), f"{reinstall} gymnasium"),
        _core("numpy", lambda: _version("numpy"), f"{reinstall} numpy"),
        _core("self test", _self_test, f"{reinstall} mujoco dappo-batch"),
    ]


def _gpu() -> Check:
    """Check for a CUDA GPU, with its command line tool or its driver."""
    tool = shutil.which("nvidia-smi")
    if tool is not None:
        query = [tool, "--query-gpu=name,driver_version,memory.total", "--format=csv,noheader"]
        try:
            done = subprocess.run(query, capture_output=True, text=True, check=False, timeout=20.0)
        except (OSError, subprocess.TimeoutExpired) as error:
            return Check("gpu", "missing", f"nvidia-smi failed: {error}")
        if done.returncode == 0 and done.stdout.strip():
            return Check("gpu", "ok", "; ".join(done.stdout.strip().splitlines()))
    try:
        cuda = ctypes.CDLL(ctypes.util.find_library("cuda") or "libcuda.so.1")
        count, version = ctypes.c_int(0), ctypes.c_int(0)
        if cuda.cuInit(0) == 0 and cuda.cuDeviceGetCount(ctypes.byref(count)) == 0 and count.value > 0:
            cuda.cuDriverGetVersion(ctypes.byref(version))
            major, minor = version.value // 1000, version.value % 1000 // 10
            return Check("gpu", "ok", f"{count.value} CUDA devices, driver for CUDA {major}.{minor}")
    except (OSError, AttributeError):
        pass
    return Check("gpu", "missing", "no NVIDIA GPU or no driver; everything runs on the CPU")


def _gpu_engine() -> Check:
    """Check the backend ``gpu``: whether this build has it, and the device that it finds."""
    try:
        return Check("gpu engine", "ok", gpu_device())
    except ConfigError as error:
        return Check("gpu engine", "missing", str(error))


def _warp() -> Check:
    """Check the GPU backend: Warp, its driver, and its devices."""
    if reason := devices.problem("warp-cpu"):
        return Check("warp", "missing", reason, "pip install dappo-batch[gpu]")
    try:
        found = devices.report()
    except Exception as error:
        # As above: any exception of a third-party library is a finding.
        return Check("warp", "failed", f"{type(error).__name__}: {error}", "pip install dappo-batch[gpu]")
    reason = devices.problem("cuda")
    return Check("warp", "missing" if reason else "ok", f"{found}; {reason}" if reason else found)


def _renderer(name: str) -> Check:
    """Render a picture without a screen, in a separate process, which a faulty driver may crash."""
    environment = os.environ | {"MUJOCO_GL": name, "PYOPENGL_PLATFORM": name}
    cure = _RENDERERS[name]
    try:
        done = subprocess.run(
            [sys.executable, "-c", _RENDER],
            capture_output=True,
            text=True,
            check=False,
            timeout=_RENDER_TIMEOUT,
            env=environment,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return Check(name, "missing", f"rendering failed: {error}", cure)
    words = done.stdout.split()
    if done.returncode == 0 and words and int(words[-1]) > 0:
        return Check(name, "ok", f"works; choose it with MUJOCO_GL={name}")
    lines = done.stderr.strip().splitlines()
    reason = lines[-1] if lines else f"exit code {done.returncode}, a black picture or none"
    return Check(name, "missing", reason, cure)


def _rendering() -> list[Check]:
    """Check every OpenGL implementation that needs no screen, and whether films can be rendered."""
    renderers = [_renderer(name) for name in _RENDERERS]
    return [*renderers, _films([check.name for check in renderers if check.status == "ok"])]


def _films(working: Sequence[str]) -> Check:
    if missing := film.lacking():
        return Check("films", "missing", f"not installed: {', '.join(missing)}", film.INSTALL)
    chosen = next((name for name in opengl.choices() if name in working), None)
    if chosen is None:
        advice = " or ".join(_RENDERERS.values())
        return Check(
            "films",
            "missing",
            "none of these OpenGL implementations works, or MUJOCO_GL selects another one",
            advice,
        )
    return Check("films", "ok", f"`dappo-batch render` uses {chosen}; mp4, GIF and PNG")


def _extra(extra: _Extra) -> Check:
    try:
        return Check(extra.package, "ok", f"{_version(extra.package)}: {extra.purpose}")
    except importlib.metadata.PackageNotFoundError:
        return Check(extra.package, "missing", extra.purpose, extra.install)


def diagnose(*, rendering: bool = True) -> dict[str, Any]:
    """Run all checks and return the findings as a dictionary that can be written as JSON.

    Parameters
    ----------
    rendering : bool
        Whether to check rendering, which takes a few seconds.

    Returns
    -------
    dict
        ``ok`` (whether the core works), ``python``, ``platform``, ``cpu``, and the groups of checks
        ``core``, ``devices``, ``rendering`` and ``extras``: name → status, detail, cure, core.
    """
    groups = {
        "core": _core_checks(),
        "devices": [_gpu(), _gpu_engine(), _warp()],
        "rendering": _rendering() if rendering else [],
        "extras": [_extra(extra) for extra in _EXTRAS],
    }
    checks = [check for group in groups.values() for check in group]
    return {
        "ok": not any(check.core and check.status == "failed" for check in checks),
        "python": {"version": platform.python_version(), "executable": sys.executable},
        "platform": platform.platform(),
        "cpu": {"name": cpu_name(), "cores": cores(), "flags": cpu_flags()},
    } | {name: {check.name: check.as_dict() for check in group} for name, group in groups.items()}


_MARKS = {"ok": "ok     ", "missing": "missing", "failed": "FAILED "}


def _text(findings: dict[str, Any]) -> str:
    cpu = findings["cpu"]
    lines = [
        f"Python {findings['python']['version']} ({findings['python']['executable']})",
        findings["platform"],
        f"{cpu['name']}, {cpu['cores']} cores, {' '.join(cpu['flags']) or 'no vector instructions known'}",
    ]
    for group in ("core", "devices", "rendering", "extras"):
        if findings[group]:
            lines += ["", group]
        for name, check in findings[group].items():
            detail, cure = check["detail"], check["cure"]
            # A reason may end with the command already.
            advice = f"; try: {cure}" if cure and cure not in detail else ""
            lines.append(f"  {_MARKS[check['status']]}  {name:18} {detail}{advice}")
    verdict = "the core works" if findings["ok"] else "the core does not work: see FAILED above"
    return "\n".join([*lines, "", verdict])


def command(*, json: bool) -> int:
    """Run ``dappo-batch doctor`` and return its exit code: 0 if the core works, otherwise 1."""
    findings = diagnose()
    print(dumps(findings, indent=2) if json else _text(findings))
    return 0 if findings["ok"] else 1
