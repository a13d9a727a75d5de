"""Specialists: policies that were trained on one damage class alone, which shows what is possible with it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from dappo_batch._core import DappoError
from dappo_batch.model.symmetry import mirror_images
from dappo_batch.report.robots import class_table
from dappo_batch.report.score import Score
from dappo_batch.runs import Run

__all__ = ["HEALTHY", "Damage", "damage_of", "references", "separated"]

Damage = frozenset[str]
"""A damage class by the names of its damages, such as ``{"missing_toe@1", "jammed_joint@2"}``."""
HEALTHY: Damage = frozenset({"healthy"})


def damage_of(run: Run) -> Damage | None:
    """Return the only damage class that a run was trained on, or None if there are several."""
    mixes = [stage.get("mix") for stage in run.config.get("curriculum", ())]
    (name, *others) = mixes or [None]
    is_one = isinstance(name, str) and name != "uniform" and all(other == name for other in others)
    return frozenset(str(name).split("+")) if is_one else None


def separated(runs: Sequence[Run]) -> tuple[list[Run], list[Run]]:
    """Return runs of learners, and evaluated specialists of one damage.

    A policy for the healthy robot is both. Without runs of several damage classes, all are learners.
    """
    damages = [damage_of(run) for run in runs]
    special = [run for run, damage in zip(runs, damages, strict=True) if damage and "true" in run.per_class]
    if all(damages):
        return list(runs), special
    return [run for run, damage in zip(runs, damages, strict=True) if damage in (None, HEALTHY)], special


def references(names: Sequence[str], specialists: Sequence[Run], score: Score) -> NDArray[np.float64]:
    """Return what specialists reach in damage classes by name, the mean over several of a class, [C].

    A symmetric robot walks as well with the mirror image of a damage, so that its specialist counts for a
    class without one of its own. Classes without a specialist are NaN.
    """
    reached: dict[Damage, list[float]] = {}
    for run in specialists:
        table, damage = run.per_class["true"], damage_of(run)
        values = table.get(score.column)
        for name, value in zip(table["name"], () if values is None else values, strict=False):
            if frozenset(str(name).split("+")) == damage:
                reached.setdefault(damage, []).append(float(value))
    damages = [frozenset(name.split("+")) for name in names]
    if not reached or all(damage in reached for damage in damages):
        images = damages
    else:
        images = _mirror_images(damages, specialists[0])
    means = {damage: float(np.mean(values)) for damage, values in reached.items()}
    return np.array(
        [means.get(damage, means.get(image, np.nan)) for damage, image in zip(damages, images, strict=True)]
    )


def _mirror_images(damages: Sequence[Damage], run: Run) -> list[Damage]:
    """Return the mirror image of every damage; the damage itself where left and right of the robot differ."""
    if not run.config["ppo"].get("symmetry"):
        return list(damages)
    try:
        table = class_table(run)
        images = mirror_images(table)
    except (DappoError, OSError):
        return list(damages)
    classes = [frozenset(item.name.split("+")) for item in table.space.classes]
    mirrored = {damage: classes[image] for damage, image in zip(classes, images, strict=True)}
    return [mirrored.get(damage, damage) for damage in damages]
