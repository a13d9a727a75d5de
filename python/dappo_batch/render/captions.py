"""Captions of frames: time, damage, and the status of the controller."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from dappo_batch.render.walk import Walk
from dappo_batch.results import Event

__all__ = ["Caption", "captions", "findings", "readable"]

_SPEED_SECONDS = 1.0  # averaging window of the shown speed


class Caption(NamedTuple):
    """The lines of a caption; empty ones are omitted."""

    time: str
    damage: str
    finding: str
    damaged: bool
    """Whether the damage is active; its line is then red like the damaged limbs."""


def captions(walk: Walk) -> list[Caption]:
    """Return the caption of every state of an episode."""
    limbs = [limb.name for limb in walk.table.robot.limbs]
    names = [item.name for item in walk.table.space.classes]
    count = len(walk.states)
    speeds = _speeds(walk, count)
    events = walk.happened
    found = (
        [walk.note] * count
        if events is None
        else [f"controller: {text}" for text in findings(events, walk.known_names or names, limbs, count)]
    )
    return [
        Caption(
            time=f"{step * walk.step_seconds:.1f} s   step {step}{speeds[step]}",
            damage=f"damage: {readable(names[damage_class], limbs)}" if damage_class else "healthy",
            finding=found[step],
            damaged=bool(damage_class),
        )
        for step, damage_class in enumerate(walk.damage_classes.tolist())
    ]


def readable(name: str, limbs: Sequence[str]) -> str:
    """Return a damage class as text.

    Parameters
    ----------
    name
        Name of the class, such as ``missing_toe@1+jammed_joint@2``.
    limbs
        Names of the limbs of the robot.
    """

    def words(part: re.Match[str]) -> str:
        limb = int(part[2])
        of = limbs[limb].replace("_", " ") if limb < len(limbs) else f"limb {limb}"
        return f"{part[1].replace('_', ' ')} ({of})"

    return " + ".join(re.sub(r"^(\w+)@(\d+)$", words, part) for part in name.split("+"))


def findings(events: Sequence[Event], names: Sequence[str], limbs: Sequence[str], count: int) -> list[str]:
    """Return the state of a controller in each of the first `count` states of the robot.

    Parameters
    ----------
    events
        Its events, in the order of steps; an event of step t belongs to state t.
    names
        Names of its damage classes.
    limbs
        Names of the limbs of the robot.
    count
        Number of states.
    """
    found, adapted, invalid, texts = "no damage suspected", "", False, []
    waiting = list(events)
    for step in range(count):
        while waiting and waiting[0].step <= step:
            event = waiting.pop(0)
            name = "" if event.damage_class is None else readable(names[event.damage_class], limbs)
            match event.kind:
                case "suspected":
                    found, adapted = "damage suspected, diagnosing", ""
                case "diagnosed":
                    word = "diagnosed as" if event.accepted else "no diagnosis:"
                    sure = f"confidence {100 * (event.confidence or 0.0):.0f} %"
                    found, adapted = f"{word} {name}, {sure}", ""
                case "withdrawn":
                    found, adapted = f"diagnosis withdrawn: {name}", ""
                case "adapted":
                    adapted = ", policy adapted" if event.damage_class else ", policy reset to healthy"
                case "observation_invalid" | "observation_valid":
                    invalid = event.kind == "observation_invalid"
        texts.append(f"{found}{adapted}{', observation invalid' if invalid else ''}")
    return texts


def _speeds(walk: Walk, count: int) -> list[str]:
    """Return the mean speed of the last second in every state, as text; empty where it is unknown."""
    velocities: NDArray[np.float64] | None = walk.velocities
    if velocities is None or len(velocities) == 0:
        return [""] * count
    window = max(1, round(_SPEED_SECONDS / walk.step_seconds))
    means = [velocities[max(0, step - window) : step].mean() for step in range(1, count)]
    # There is no velocity before the first step.
    return ["", *(f"   {mean:.2f} m/s" for mean in means)]
