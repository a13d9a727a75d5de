"""The kernels of the GPU engine as CUDA C++, compiled for a GPU that need not be there."""

from __future__ import annotations

import ctypes
import importlib.util
import json
import os
import re
import shutil
import subprocess
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from dappo_batch import ClassTable
from dappo_batch.model.clamped_actuators import clamped_without_derivative
from dappo_batch.model.rotation_correction import rotation_correction

__all__ = ["EXAMPLE", "Unavailable", "Usage", "compile_kernel", "emit", "emit_rollout", "find_toolkit"]

EXAMPLE = (
    *("cargo", "build", "--release", "--locked", "--package", "dappo-sim"),
    *("--features", "cuda-source", "--example", "cuda_source"),
)
"""Builds the program that writes the kernel of a robot."""

ROLLOUT = (
    *("cargo", "test", "--release", "--locked", "--package", "dappo-gpu"),
    *("--features", "cuda-source", "--test", "envs", "cuda_can_express"),
)
"""Writes the kernels of a rollout with every term and event into the folder ``DAPPO_CUDA_SOURCE``."""

_ROOT = Path(__file__).parents[2]
_WHEELS = " ".join(f"nvidia-cuda-{part}" for part in ("nvrtc", "nvcc", "nvdisasm", "runtime", "cccl"))


class Unavailable(Exception):
    """Something to compile with is not installed."""


@dataclass(frozen=True)
class Usage:
    """What a compiled kernel takes; ``stack``, ``spill_stores`` and ``spill_loads`` in bytes of a thread."""

    registers: int
    stack: int
    spill_stores: int
    spill_loads: int
    instructions: int


def find_toolkit() -> Path:
    """Return the folder of a CUDA toolkit with NVRTC, from PyPI or from the system."""
    spec = importlib.util.find_spec("nvidia")
    wheels = [Path(path) / "cu13" for path in (spec and spec.submodule_search_locations) or ()]
    named = [Path(os.environ[name]) for name in ("CUDA_PATH", "CUDA_HOME") if os.environ.get(name)]
    for folder in (*named, *wheels, Path("/usr/local/cuda")):
        tools = (folder / "bin/ptxas", folder / "bin/nvdisasm")
        if all(tool.is_file() for tool in tools) and list(folder.glob("lib*/libnvrtc.so*")):
            return folder
    raise Unavailable(f"there is no CUDA toolkit; pip install {_WHEELS}")


def emit(table: ClassTable, folder: Path, seconds: float) -> str:
    """Return the kernel of a robot in single precision as CUDA C++; `EXAMPLE` may take so many seconds."""
    _build(EXAMPLE, {}, seconds)
    robot, kernel = folder / "robot.json", folder / "kernel.cu"
    robot.write_text(json.dumps(_numbers(table)))
    target = _ROOT / os.environ.get("CARGO_TARGET_DIR", "target")
    subprocess.run([target / "release/examples/cuda_source", robot, kernel], check=True)
    return kernel.read_text()


def emit_rollout(folder: Path, seconds: float) -> dict[str, str]:
    """Return the other kernels of a rollout by name; `ROLLOUT` may take so many seconds."""
    _build(ROLLOUT, {"DAPPO_CUDA_SOURCE": str(folder)}, seconds)
    return {path.stem: path.read_text() for path in sorted(folder.glob("*.cu"))}


def _build(command: tuple[str, ...], variables: dict[str, str], seconds: float) -> None:
    if shutil.which("cargo") is None:
        raise Unavailable("there is no cargo")
    try:
        subprocess.run(command, cwd=_ROOT, env=os.environ | variables, check=True, timeout=seconds)
    except subprocess.TimeoutExpired:
        raise Unavailable(f"it takes long to compile; do it first: {' '.join(command)}") from None


def compile_kernel(source: str, arch: str, toolkit: Path, folder: Path) -> Usage:
    """Compile CUDA C++ as cubecl and the driver do, for one architecture, as ``90a``."""
    ptx, cubin = folder / "kernel.ptx", folder / "kernel.cubin"
    ptx.write_bytes(_to_ptx(source, f"sm_{arch}", toolkit))
    assembled = _run(toolkit / "bin/ptxas", "-v", f"-arch=sm_{arch}", ptx, "-o", cubin)
    listing = _run(toolkit / "bin/nvdisasm", "-c", cubin)

    def number(pattern: str) -> int:
        return int(re.findall(pattern, assembled)[0])

    return Usage(
        registers=number(r"Used (\d+) registers"),
        stack=number(r"(\d+) bytes stack frame"),
        spill_stores=number(r"(\d+) bytes spill stores"),
        spill_loads=number(r"(\d+) bytes spill loads"),
        instructions=len(re.findall(r"/\*[0-9a-f]{4,}\*/\s+[^/\s]", listing)),
    )


def _numbers(table: ClassTable) -> dict[str, Any]:
    """Return a class table as what the example reads."""
    limbs = range(table.space.limbs)
    return {
        "models": [dict(_fields(model)) for model in table.all_models],
        "main_body": table.main_body,
        "touch_addresses": table.touch_addresses,
        "disabled_touch": [[limb in disabled for limb in limbs] for disabled in table.disabled_touch],
        "rotation_correction": rotation_correction(),
        "clamped_without_derivative": clamped_without_derivative(),
    }


def _fields(model: Any) -> Iterator[tuple[str, list[float]]]:  # noqa: ANN401 - a type of MuJoCo
    yield "names", list(model.names)
    for prefix, part in (("", model), ("opt.", model.opt), ("stat.", model.stat)):
        for name in dir(part):
            value = None if name.startswith("_") else getattr(part, name)
            if isinstance(value, int | float | np.ndarray):
                yield prefix + name, np.ravel(value).astype(np.float64).tolist()


def _run(*command: str | Path) -> str:
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode != 0:
        raise RuntimeError(f"{command[0]}: {done.stderr[-3000:]}")
    return done.stdout + done.stderr


def _to_ptx(source: str, arch: str, toolkit: Path) -> bytes:
    """Compile with NVRTC, with the options of cubecl-cuda."""
    nvrtc = ctypes.CDLL(str(next(toolkit.glob("lib*/libnvrtc.so*"))))
    program, size = ctypes.c_void_p(), ctypes.c_size_t()
    include = toolkit / "include"
    options = [f"--gpu-architecture={arch}", f"--include-path={include}", f"--include-path={include}/cccl"]

    def text(kind: str) -> bytes:
        getattr(nvrtc, f"nvrtcGet{kind}Size")(program, ctypes.byref(size))
        buffer = ctypes.create_string_buffer(size.value)
        getattr(nvrtc, f"nvrtcGet{kind}")(program, buffer)
        return buffer.value

    nvrtc.nvrtcCreateProgram(ctypes.byref(program), source.encode(), b"kernel.cu", 0, None, None)
    try:
        encoded = (ctypes.c_char_p * len(options))(*(option.encode() for option in options))
        if nvrtc.nvrtcCompileProgram(program, len(options), encoded) != 0:
            raise RuntimeError(f"NVRTC: {text('ProgramLog').decode()[:3000]}")
        return text("PTX")
    finally:
        nvrtc.nvrtcDestroyProgram(ctypes.byref(program))
