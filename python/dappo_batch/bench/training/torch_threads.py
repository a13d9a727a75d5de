"""How many of its threads PyTorch had better use."""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable

__all__ = ["use_fastest"]

_TRIALS = 2  # the best of them counts: what interrupts one should not decide


def use_fastest(most: int, iterate: Callable[[], object]) -> str:
    """Try iterations with one thread and with `most`, keep the faster setting, and say what it is.

    Threads of OpenMP wait for each other by spinning after every small product; on a busy machine one thread
    can be several times as fast as two.
    """
    torch = importlib.import_module("torch")
    iterate()  # what a first iteration allocates and loads must not decide
    seconds = dict.fromkeys(sorted({1, most}), float("inf"))
    for count in [*seconds] * _TRIALS:
        torch.set_num_threads(count)
        start = time.perf_counter()
        iterate()
        seconds[count] = min(seconds[count], time.perf_counter() - start)
    best = min(seconds, key=lambda count: seconds[count])
    torch.set_num_threads(best)
    found = ", ".join(f"{count}: {time:.2f}" for count, time in seconds.items())
    return f"torch with {best} of {most} threads, as the faster setting in a trial (s an iteration: {found})"
