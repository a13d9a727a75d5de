"""Figures of evaluations: learners beside each other, over groups, classes and what they are told."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from dappo_batch.report.learners import Learner
from dappo_batch.report.picture import Picture, canvas, legend
from dappo_batch.report.theme import INK, LINE, MUTED, SERIES

__all__ = ["against", "classes", "encodings", "groups", "means_of_groups"]

_WHISKERS = "Bars are means over seeds, whiskers reach from the lowest to the highest."
_TOLD = {"true": "the truth", "zero": "nothing", "wrong": "another damage", "random": "noise"}
_AROUND = 0.6  # in, above and below bars
_CLASSES = 25
"""Most classes in one figure: it should not be much taller than a screen."""


def classes(robot: str, learners: Sequence[Learner]) -> list[Picture]:
    """Draw the forward reward of every damage class, learner beside learner, in figures of one scale."""
    names = [str(name) for name in learners[0].evaluated()[0].per_class["true"]["name"]]
    values = [learner.forward_rewards() for learner in learners]
    farthest = max(float(rewards.max()) for rewards in values)
    count = -(-len(names) // _CLASSES)
    drawn = []
    for number, part in enumerate(np.array_split(np.arange(len(names)), count), start=1):
        file, title = f"{robot}-classes", "Forward reward of every damage class"
        if count > 1:
            file, title = f"{file}-{number}", f"{title}, {number} of {count}"
        some = [rewards[:, part] for rewards in values]
        drawn.append(
            _bars(file, title, [names[index] for index in part], learners, some, thickness=0.13, to=farthest)
        )
    return drawn


def groups(robot: str, learners: Sequence[Learner]) -> Picture:
    """Draw the mean forward reward of every group of damage classes, and of all."""
    per_learner = [means_of_groups(learner) for learner in learners]
    names = list(per_learner[0])
    values = [np.stack([means[name] for name in names], axis=1) for means in per_learner]
    title = "Forward reward of groups of damage classes"
    return _bars(f"{robot}-groups", title, names, learners, values, thickness=0.16)


def means_of_groups(learner: Learner) -> dict[str, NDArray[np.float64]]:
    """Return the mean over the classes of every group, and ``all``: one number a seed, [S]."""
    rewards = learner.forward_rewards()
    of_class = learner.evaluated()[0].per_class["true"]["group"].astype(str)
    names = dict.fromkeys(str(name) for name in of_class)
    means = {name: rewards[:, of_class == name].mean(axis=1) for name in names}
    return means | {"all": rewards.mean(axis=1)}


def encodings(robot: str, learners: Sequence[Learner]) -> Picture | None:
    """Draw the mean forward reward by what the policy is told; None if each was only told the truth."""
    told_another = [learner for learner in learners if any(map(learner.evaluated, list(_TOLD)[1:]))]
    told = [encoding for encoding in _TOLD if all(learner.evaluated(encoding) for learner in told_another)]
    if not told_another or len(told) < 2:
        return None
    # Seeds of one bar must be those of the others.
    compared = [learner.only(told) for learner in told_another]
    if not all(learner.runs for learner in compared):
        return None
    values = [
        np.stack([learner.forward_rewards(encoding).mean(axis=1) for encoding in told], axis=1)
        for learner in compared
    ]
    title = "What the policy is told"
    names = [_TOLD[encoding] for encoding in told]
    return _bars(f"{robot}-encodings", title, names, compared, values, thickness=0.2)


def against(robot: str, aware: Learner, unaware: Learner, number: int) -> Picture:
    """Draw the classes' forward rewards of two learners against each other."""
    ours, theirs = aware.forward_rewards().mean(0), unaware.forward_rewards().mean(0)
    figure, (axes,) = canvas(3.0)
    low, high = min(ours.min(), theirs.min(), 0.0), 1.05 * max(ours.max(), theirs.max(), 1.0)
    axes.plot([low, high], [low, high], color=MUTED, linewidth=1, linestyle="--")
    of_class = aware.evaluated()[0].per_class["true"]["group"].astype(str)
    for index, group in enumerate(dict.fromkeys(of_class)):
        chosen = of_class == group
        colour = SERIES[index % len(SERIES)]
        marker = "os^"[index // len(SERIES) % 3]
        axes.scatter(theirs[chosen], ours[chosen], 22, color=colour, marker=marker, label=group)
    axes.set_xlabel(unaware.name)
    axes.set_ylabel(aware.name)
    axes.set_box_aspect(1.0)
    axes.set_xlim(low, high)
    axes.set_ylim(low, high)
    figure.legend(loc="outside right upper")
    ahead = int((ours > theirs).sum())
    caption = (
        f"Forward reward of every damage class, means over seeds; above the line {aware.name} is ahead, "
        f"in {ahead} of {len(ours)} classes."
    )
    return Picture(f"{robot}-against-{number}", f"{aware.name} against {unaware.name}", caption, figure)


def _bars(
    file: str,
    title: str,
    names: Sequence[str],
    learners: Sequence[Learner],
    values: Sequence[NDArray[np.float64]],
    *,
    thickness: float,
    to: float | None = None,
) -> Picture:
    """Draw groups of bars downwards; `values` are [S, B] a learner, `thickness` is in inches."""
    group = thickness * (len(learners) + 0.6)
    figure, (axes,) = canvas(_AROUND + LINE * len(learners) + group * len(names))
    for row, (learner, rewards) in enumerate(zip(learners, values, strict=True)):
        place = np.arange(len(names)) + (row - (len(learners) - 1) / 2) * thickness / group
        colour = SERIES[learner.place % len(SERIES)]
        mean = rewards.mean(0)
        axes.barh(place, mean, 0.9 * thickness / group, color=colour, label=learner.label())
        if len(rewards) > 1:
            _whiskers(axes, rewards, place)
    axes.set_yticks(range(len(names)), names, fontsize=7 if len(names) > 12 else 8)
    axes.set_ylim(len(names) - 0.5, -0.5)
    if to is not None:
        axes.set_xlim(right=1.05 * to)
    axes.grid(visible=False, axis="y")
    axes.set_xlabel("forward reward")
    legend(figure)
    return Picture(file, title, f"{title}. {_WHISKERS}", figure)


def _whiskers(axes: Axes, rewards: NDArray[np.float64], place: NDArray[Any]) -> None:
    axes.hlines(place, rewards.min(0), rewards.max(0), color=INK, linewidth=0.7)
