"""The machine: its processor, and the versions of software that affect measurements."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

__all__ = ["cores", "cpu_flags", "cpu_name", "describe", "text"]

_CPUINFO = Path("/proc/cpuinfo")
_FLAGS = ("avx2", "fma", "avx512f", "asimd", "sve")


def _cpuinfo(*keys: str) -> str:
    """Return the first value of one of `keys` in Linux's description of the processor, or an empty text."""
    try:
        text = _CPUINFO.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""
    for line in text.splitlines():
        name, _, value = line.partition(":")
        if name.strip() in keys:
            return value.strip()
    return ""


def cpu_name() -> str:
    """Return the name of the processor."""
    return _cpuinfo("model name", "Hardware") or platform.processor() or platform.machine()


def cpu_flags() -> list[str]:
    """Return the vector instruction sets of the processor that affect speed."""
    present = set(_cpuinfo("flags", "Features").split())
    return [flag for flag in _FLAGS if flag in present]


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _load_average() -> float | None:
    """Return the load average of the last minute, if the system has it."""
    try:
        return os.getloadavg()[0]
    except (AttributeError, OSError):
        return None


def describe() -> dict[str, Any]:
    """Return processor, cores, load average and versions, as a dictionary that can be written as JSON."""
    return {
        "cpu": cpu_name(),
        "flags": cpu_flags(),
        "cores": cores(),
        "load_average": _load_average(),
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def text(machine: Mapping[str, Any]) -> str:
    """Return the result of `describe` as two lines of text."""
    load = "unknown" if machine["load_average"] is None else f"{machine['load_average']:.2f}"
    return (
        f"{machine['cpu']}, {' '.join(machine['flags']) or 'no vector instructions known'},"
        f" {machine['cores']} cores, load average {load} at the start\n"
        f"mujoco {machine['mujoco']}, numpy {machine['numpy']}, Python {machine['python']}"
    )
