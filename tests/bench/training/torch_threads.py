"""How many of its threads PyTorch had better use."""

from __future__ import annotations

import importlib
from collections.abc import Callable

from ..trial import fastest

__all__ = ["use_fastest"]


def use_fastest(most: int, iterate: Callable[[], object]) -> str:
    """Try iterations with one thread and with `most`, keep the faster setting, and say what it is.

    Threads of OpenMP wait for each other by spinning after every small product; on a busy machine one thread
    can be several times as fast as two.
    """
    torch = importlib.import_module("torch")
    best, seconds = fastest(sorted({1, most}), torch.set_num_threads, iterate)
    found = ", ".join(f"{count}: {time:.2f}" for count, time in seconds.items())
    return f"torch with {best} of {most} threads, as the faster setting in a trial (s an iteration: {found})"
