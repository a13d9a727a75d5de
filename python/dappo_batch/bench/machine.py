"""The machine that measurements and complaints are about."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

__all__ = ["cores", "cpu_flags", "cpu_name", "describe", "limited_to", "load_average", "thread_limits"]

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


def describe() -> dict[str, Any]:
    """Return what a report says about the machine and its software."""
    return {
        "cpu": cpu_name(),
        "cores": cores(),
        "load_average": load_average(),
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }


def thread_limits(threads: int) -> dict[str, str]:
    """Return the environment variables that size the thread pools of linear algebra in a new process."""
    pools = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return dict.fromkeys(pools, str(threads))


@contextmanager
def limited_to(threads: int) -> Iterator[None]:
    """Let this process and those that it starts run on `threads` cores, where the system can do that.

    Variables and arguments do not reach everything: a contender may start processes of its own.
    """
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    allowed = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(allowed)[:threads]))
    try:
        yield
    finally:
        os.sched_setaffinity(0, allowed)
