"""Which of several settings a contender had better use."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TypeVar

__all__ = ["fastest"]

T = TypeVar("T")

_TRIALS = 2  # the best of them counts: what interrupts one should not decide


def fastest(
    choices: Sequence[T], choose: Callable[[T], object], work: Callable[[], object]
) -> tuple[T, dict[T, float]]:
    """Try the same work with each choice, and leave the fastest chosen.

    Parameters
    ----------
    choices : sequence
        What there is to choose from.
    choose : callable
        Makes a choice effective.
    work : callable
        What is timed.

    Returns
    -------
    tuple
        The fastest choice, and the time of each, s.
    """
    work()  # what a first time allocates and loads must not decide
    seconds = dict.fromkeys(choices, float("inf"))
    for choice in [*seconds] * _TRIALS:
        choose(choice)
        start = time.perf_counter()
        work()
        seconds[choice] = min(seconds[choice], time.perf_counter() - start)
    best = min(seconds, key=lambda choice: seconds[choice])
    choose(best)
    return best, seconds
