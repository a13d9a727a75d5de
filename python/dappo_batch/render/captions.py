"""What stands on the pictures: the time, the damage, and what the controller makes of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dappo_batch.render.walk import Walk
from dappo_batch.results import Event

__all__ = ["Caption", "beliefs", "captions"]

_SPEED_SECONDS = 1.0  # over which the shown speed is averaged: one that changes all the time cannot be read


class Caption(NamedTuple):
    """The lines on one picture; empty ones are left out."""

    time: str
    damage: str
    belief: str
    damaged: bool
    """Whether the damage is in force, and its line as red as the limbs."""


def captions(walk: Walk) -> list[Caption]:
    """Return the caption of every state of a walk."""
    names = [item.name for item in walk.table.space.classes]
    count = len(walk.states)
    speeds = _speeds(walk, count)
    events = walk.happened
    believed = (
        [walk.note] * count
        if events is None
        else [f"controller: {belief}" for belief in beliefs(events, walk.known_names or names, count)]
    )
    return [
        Caption(
            time=f"{step * walk.step_seconds:.1f} s   step {step}{speeds[step]}",
            damage=f"damage: {names[damage_class] if damage_class else 'none'}",
            belief=believed[step],
            damaged=bool(damage_class),
        )
        for step, damage_class in enumerate(walk.damage_classes.tolist())
    ]


def beliefs(events: Sequence[Event], names: Sequence[str], count: int) -> list[str]:
    """Return what a controller believes in each of the first `count` states.

    Parameters
    ----------
    events
        What it did, in the order of steps; an event of step t is decided upon in state t.
    names
        Names of the damage classes that it knows.
    count
        Number of states.
    """
    believed, lost, said = "healthy", False, []
    waiting = list(events)
    for step in range(count):
        while waiting and waiting[0].step <= step:
            event = waiting.pop(0)
            name = "" if event.damage_class is None else names[event.damage_class]
            match event.kind:
                case "suspected":
                    believed = "examining …"
                case "diagnosed":
                    word = "diagnosis" if event.accepted else "not sure"
                    believed = f"{word}: {name} ({100 * (event.confidence or 0.0):.0f} %)"
                case "withdrawn":
                    believed = f"not {name}: taken for healthy"
                case "readings_lost" | "readings_back":
                    lost = event.kind == "readings_lost"
        said.append(f"{believed}, readings lost" if lost else believed)
    return said


def _speeds(walk: Walk, count: int) -> list[str]:
    """Return the mean speed of the last second in every state, as text; nothing where it is unknown."""
    velocities: NDArray[np.float64] | None = walk.velocities
    if velocities is None or len(velocities) == 0:
        return [""] * count
    window = max(1, round(_SPEED_SECONDS / walk.step_seconds))
    means = [velocities[max(0, step - window) : step].mean() for step in range(1, count)]
    # Before the first step nothing has been measured.
    return ["", *(f"   {mean:.2f} m/s" for mean in means)]
