"""Which states become pictures, and for how long each is shown."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["Schedule", "schedule"]


@dataclass(frozen=True)
class Schedule:
    """The states that are shown, and the time that each of them is, s."""

    states: list[int]
    seconds: float


def schedule(states: int, step_seconds: float, *, fastest: float, unit: float | None = None) -> Schedule:
    """Spread the states of a walk over pictures, in real time.

    Parameters
    ----------
    states : int
        Number of states.
    step_seconds : float
        Time between two of them, s.
    fastest : float
        Most pictures a second. States that come faster are left out.
    unit : float, optional
        What the time of a picture is a multiple of, s, in formats that have such a unit.
    """
    seconds = max(step_seconds, 1.0 / fastest)
    if unit is not None:
        seconds = max(1, round(seconds / unit)) * unit
    # The small number makes up for rounding where a picture falls on a state.
    last = math.floor((states - 1) * step_seconds / seconds + 1e-9)
    shown = [min(states - 1, math.floor(index * seconds / step_seconds + 1e-9)) for index in range(last + 1)]
    return Schedule(shown, seconds)
