"""The number of threads with which PyTorch is fastest."""

from __future__ import annotations

import importlib
from collections.abc import Callable

from ..autotune import fastest

__all__ = ["use_fastest"]


def use_fastest(most: int, iterate: Callable[[], object]) -> str:
    """Time iterations with one thread and with `most`, apply the faster setting, and return it as text.

    Threads of OpenMP wait for each other by spinning after every small product; on a busy machine one thread
    can be several times as fast as two.
    """
    torch = importlib.import_module("torch")
    best, seconds = fastest(sorted({1, most}), torch.set_num_threads, iterate)
    found = ", ".join(f"{count}: {time:.2f}" for count, time in seconds.items())
    return f"torch with {best} of {most} threads, the faster setting (s an iteration: {found})"
