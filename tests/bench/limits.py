"""Limits of the processor time of trainers: threads of linear algebra, and cores."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

__all__ = ["limited_to", "thread_limits"]


def thread_limits(threads: int) -> dict[str, str]:
    """Return the environment variables that size the thread pools of linear algebra in a new process."""
    pools = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return dict.fromkeys(pools, str(threads))


@contextmanager
def limited_to(threads: int) -> Iterator[None]:
    """Limit this process and its children to `threads` cores, if the system supports it.

    Variables and arguments do not limit everything: a trainer may start processes itself.
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
