"""The machine that measurements and complaints are about."""

from __future__ import annotations

import os
import platform
from pathlib import Path

__all__ = ["cores", "cpu_flags", "cpu_name", "load_average"]

_CPUINFO = Path("/proc/cpuinfo")
_FLAGS = ("avx2", "fma", "avx512f", "asimd", "sve")


def _cpuinfo(*keys: str) -> str:
    """Return the first value of one of `keys` in Linux's description of the processor, or nothing."""
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
    """Return the processor's name, as far as the system tells."""
    return _cpuinfo("model name", "Hardware") or platform.processor() or platform.machine()


def cpu_flags() -> list[str]:
    """Return which of the vector instruction sets that matter for speed the processor has."""
    present = set(_cpuinfo("flags", "Features").split())
    return [flag for flag in _FLAGS if flag in present]


def cores() -> int:
    """Return how many cores this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def load_average() -> float | None:
    """Return the mean number of running processes in the last minute, where the system counts them."""
    try:
        return os.getloadavg()[0]
    except (AttributeError, OSError):
        return None
