"""The states that become frames, and their durations."""

from __future__ import annotations

import math
from dataclasses import dataclass

__all__ = ["Schedule", "evenly", "schedule"]


@dataclass(frozen=True)
class Schedule:
    """The states to show, and the duration of each, s."""

    states: list[int]
    seconds: float


def schedule(states: int, step_seconds: float, *, fastest: float, unit: float | None = None) -> Schedule:
    """Select the states of an episode for frames, in real time.

    Parameters
    ----------
    states : int
        Number of states.
    step_seconds : float
        Time between two states, s.
    fastest : float
        Most frames a second. States that come faster are left out.
    unit : float, optional
        What the time of a frame is a multiple of, s, in formats that have such a unit; in others it is one
        of `step_seconds`, so that the robot moves evenly.
    """
    # The small number compensates for rounding if a frame coincides with a state.
    unit = step_seconds if unit is None else unit
    seconds = math.ceil(max(step_seconds, 1.0 / fastest) / unit - 1e-9) * unit
    last = math.floor((states - 1) * step_seconds / seconds + 1e-9)
    shown = [min(states - 1, math.floor(index * seconds / step_seconds + 1e-9)) for index in range(last + 1)]
    return Schedule(shown, seconds)


def evenly(states: int, frames: int) -> list[int]:
    """Return at most `frames` evenly spaced states of an episode, including the last one."""
    if frames == 1 or states == 1:
        return [states - 1]
    count = min(frames, states)
    return [round(index * (states - 1) / (count - 1)) for index in range(count)]
