"""The fastest of several settings of a trainer."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from typing import TypeVar

__all__ = ["fastest"]

T = TypeVar("T")

_REPEATS = 2  # the best counts, so that an interruption of one does not decide


def fastest(
    choices: Sequence[T], choose: Callable[[T], object], work: Callable[[], object]
) -> tuple[T, dict[T, float]]:
    """Time the same work with each choice, and apply the fastest one.

    Parameters
    ----------
    choices : sequence
        The choices.
    choose : callable
        Applies a choice.
    work : callable
        The work to time.

    Returns
    -------
    tuple
        The fastest choice, and the time of each, s.
    """
    work()  # the first call allocates and loads, and is not timed
    seconds = dict.fromkeys(choices, float("inf"))
    for choice in [*seconds] * _REPEATS:
        choose(choice)
        start = time.perf_counter()
        work()
        seconds[choice] = min(seconds[choice], time.perf_counter() - start)
    best = min(seconds, key=lambda choice: seconds[choice])
    choose(best)
    return best, seconds
