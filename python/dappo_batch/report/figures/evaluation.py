"""Figures of evaluations: learners over groups of damage classes, single classes and encodings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dappo_batch.report.benchmark import Entry
from dappo_batch.report.figures.parts import keys, metres
from dappo_batch.report.learners import Learner, Scores
from dappo_batch.report.picture import HALF, Key, Picture, canvas
from dappo_batch.report.theme import BAND, INK, MUTED, Mark, mark

__all__ = ["against", "classes", "encodings", "groups", "profile"]

_ENCODINGS = {
    "true": "true damage code",
    "zero": "all zeros: healthy",
    "wrong": "code of another class",
    "random": "random code",
}
_AROUND = 1.1  # in, above and below rows
_LINE = 0.29  # in, of a row with a label of two lines
_ROOM = 0.075  # in, of a learner in a row
_ROWS = 13
"""Maximum number of damage classes in a figure."""

_Array: TypeAlias = NDArray[np.float64]


def classes(robot: str, learners: Sequence[Learner], seconds: float | None) -> list[Picture]:
    """Draw the score in every damage class, group after group, in figures of one scale."""
    scores = [learner.scores() for learner in learners]
    groups = list(dict.fromkeys(scores[0].groups))
    order = np.array(
        sorted(range(len(scores[0].names)), key=lambda index: groups.index(scores[0].groups[index]))
    )
    scores = [each.only(order) for each in scores]
    ends = [_reach(each) for each in scores]
    reach = (min(low for low, _ in ends), max(high for _, high in ends))
    parts = np.array_split(np.arange(len(order)), -(-len(order) // _ROWS))
    drawn = []
    for number, part in enumerate(parts, start=1):
        file, title = f"{robot}-classes", "Damage classes"
        if len(parts) > 1:
            file, title = f"{file}-{number}", f"{title}, {number} of {len(parts)}"
        some = [each.only(part) for each in scores]
        picture = _dots(file, title, learners, some, seconds, reach)
        # Only the first figure has a caption.
        drawn.append(picture if number == 1 else replace(picture, caption=""))
    return drawn


def groups(robot: str, learners: Sequence[Learner], seconds: float | None) -> Picture:
    """Draw the mean score of every group of damage classes, and of all."""
    scores = [learner.scores().of_groups() for learner in learners]
    return _dots(f"{robot}-groups", "Groups of damage classes", learners, scores, seconds)


def encodings(robot: str, learners: Sequence[Learner], seconds: float | None) -> Picture | None:
    """Draw the mean score by encoding; None if there is only ``true``."""
    given_another = [learner for learner in learners if any(map(learner.evaluated, list(_ENCODINGS)[1:]))]
    given = [
        encoding for encoding in _ENCODINGS if all(learner.evaluated(encoding) for learner in given_another)
    ]
    if not given_another or len(given) < 2:
        return None
    # All rows must have the same seeds.
    compared = [learner.only(given) for learner in given_another]
    if not all(learner.runs for learner in compared):
        return None
    names = tuple(_ENCODINGS[encoding] for encoding in given)
    scores = []
    for learner in compared:
        # The last group is that of all classes.
        means = [learner.scores(encoding).of_groups().only(np.array([-1])) for encoding in given]
        joined = (
            np.concatenate([getattr(mean, values) for mean in means], axis=1)
            for values in ("values", "errors", "lengths")
        )
        scores.append(Scores(names, names, *joined))
    return _dots(f"{robot}-encodings", "Observed damage code", compared, scores, seconds)


def against(robot: str, aware: Learner, unaware: Learner, number: int) -> Picture:
    """Draw the scores of two learners in every damage class against each other."""
    scores = aware.scores()
    (ours, our_errors), (theirs, their_errors) = scores.over_seeds(), unaware.scores().over_seeds()
    of_class = np.array(scores.groups)
    legend = []
    for place, group in enumerate(dict.fromkeys(scores.groups)):
        how = mark(place)
        legend.append(Key(group, Mark(how.colour, "", how.marker)))

    def draw(width: float) -> Figure:
        figure, (axes,) = canvas(width, min(width, 4.6))
        # Without the axes' own margins the line would end before the corners.
        low, high = min(ours.min(), theirs.min(), 0.0), max(ours.max(), theirs.max(), 1.0)
        ends = low - 0.06 * (high - low), high + 0.06 * (high - low)
        axes.plot(ends, ends, color=MUTED, linewidth=1, linestyle="--")
        for key in legend:
            chosen = of_class == key.label
            colour = key.mark.colour
            across, up = (np.nan_to_num(errors[chosen]) for errors in (their_errors, our_errors))
            axes.errorbar(
                theirs[chosen], ours[chosen], up, across, "none", ecolor=colour, elinewidth=0.7, alpha=0.6
            )
            axes.scatter(theirs[chosen], ours[chosen], 22, color=colour, marker=key.mark.marker, zorder=3)
        axes.set_xlabel(f"{aware.score.name} of {unaware.name}")
        axes.set_ylabel(f"{aware.score.name} of {aware.name}")
        axes.set_box_aspect(1.0)
        axes.set_xlim(*ends)
        axes.set_ylim(*ends)
        return figure

    ahead = int((ours > theirs).sum())
    caption = f"{aware.score.title} in every damage class{_of_seeds([aware, unaware])}. "
    caption += f"Above the dashed line {aware.name} is ahead: in {ahead} of {len(ours)} classes."
    caption += _of_errors([our_errors, their_errors])
    title = f"{aware.name} and {unaware.name}"
    return Picture(f"{robot}-against-{number}", title, caption, draw, tuple(legend), HALF)


def profile(robot: str, entries: Sequence[Entry]) -> Picture:
    """Draw in how many of the damage classes and seeds each learner reaches a share of the specialist."""
    drawn = [(entry, np.sort(entry.shares, axis=None)) for entry in entries if entry.shares is not None]
    marks = [
        Mark(MUTED, "--") if entry.learner is None else replace(mark(entry.learner.place), marker="")
        for entry, _ in drawn
    ]

    def draw(width: float) -> Figure:
        figure, (axes,) = canvas(width, min(width, 3.2))
        for (_, shares), how in zip(drawn, marks, strict=True):
            reached = 1 - np.arange(len(shares) + 1) / len(shares)
            axes.step(
                np.append(shares, shares[-1]), reached, where="pre", color=how.colour, linestyle=how.dash
            )
        axes.set_xlabel("share of the specialist")
        axes.set_ylabel("share of classes and seeds that reach it")
        axes.set_xlim(left=min(0.0, *(float(shares[0]) for _, shares in drawn)))
        axes.set_ylim(0.0, 1.02)
        return figure

    caption = (
        "Share of the damage classes and seeds in which at least so much of the specialist's "
        f"{entries[0].learner.score.name if entries[0].learner else 'score'} is reached."
    )
    legend = tuple(Key(entry.name, how) for (entry, _), how in zip(drawn, marks, strict=True))
    return Picture(f"{robot}-profile", "Shares of specialists", caption, draw, legend, HALF)


def _ends(values: _Array, errors: _Array) -> tuple[_Array, _Array]:
    """Return both ends of error bars; of unknown errors, both at the value."""
    errors = np.nan_to_num(errors)
    return values - errors, values + errors


def _reach(scores: Scores) -> tuple[float, float]:
    """Return the least and the largest value that is drawn."""
    low, high = _ends(*scores.over_seeds())
    return float(min(low.min(), scores.values.min())), float(max(high.max(), scores.values.max()))


def _of_seeds(learners: Sequence[Learner]) -> str:
    return ", mean over seeds" if any(len(learner.evaluated()) > 1 for learner in learners) else ""


def _of_errors(errors: Sequence[_Array]) -> str:
    known = any(bool(np.isfinite(each).any()) for each in errors)
    return " Error bars: standard error of the mean over episodes." if known else ""


def _dots(
    file: str,
    title: str,
    learners: Sequence[Learner],
    scores: Sequence[Scores],
    seconds: float | None,
    reach: tuple[float, float] | None = None,
) -> Picture:
    """Draw a row for every class, group or encoding, and in it a marker for every learner."""
    names, of_row, score = scores[0].names, scores[0].groups, learners[0].score
    row = max(_LINE if any("+" in name for name in names) else 0.2, _ROOM * len(learners) + 0.08)

    def draw(width: float) -> Figure:
        figure, (axes,) = canvas(width, _AROUND + row * len(names))
        _bands(axes, of_row)
        for index, (learner, each) in enumerate(zip(learners, scores, strict=True)):
            how = mark(learner.place)
            place = np.arange(len(names)) + (index - (len(learners) - 1) / 2) * _ROOM / row
            mean, errors = each.over_seeds()
            axes.hlines(place, *_ends(mean, errors), color=how.colour, linewidth=1.1)
            if len(each.values) > 1:
                axes.scatter(
                    each.values,
                    np.tile(place, (len(each.values), 1)),
                    7,
                    facecolor="none",
                    edgecolor=how.colour,
                    linewidth=0.5,
                    marker=how.marker,
                    alpha=0.8,
                )
            axes.scatter(mean, place, 17, color=how.colour, marker=how.marker, zorder=3)
        labels = [name.replace("+", " +\n") for name in names]
        axes.set_yticks(range(len(names)), labels, fontsize=7.5, linespacing=1.05)
        axes.tick_params(axis="y", length=0)
        axes.set_ylim(len(names) - 0.5, -0.5)
        if reach is not None:
            margin = 0.04 * max(reach[1] - reach[0], 1e-9)
            axes.set_xlim(reach[0] - margin, reach[1] + margin)
        if axes.get_xlim()[0] < 0 < axes.get_xlim()[1]:
            axes.axvline(0.0, color=MUTED, linewidth=0.8)
        axes.grid(visible=False, axis="y")
        axes.set_xlabel(score.axis, color=INK)
        metres(axes, seconds, "x")
        return figure

    caption = f"{score.title}{_of_seeds(learners)}." + _of_errors([each.over_seeds()[1] for each in scores])
    if any(len(each.values) > 1 for each in scores):
        caption += " Hollow markers: single seeds."
    return Picture(file, title, caption, draw, keys(learners, lines=False))


def _bands(axes: Axes, groups: Sequence[str]) -> None:
    """Set groups apart by their background, and name those of more than a row at the right."""
    if len(set(groups)) == len(groups):
        return
    start = 0
    for number, group in enumerate(dict.fromkeys(groups)):
        end = start + groups.count(group)
        if number % 2 == 0:
            axes.axhspan(start - 0.5, end - 0.5, color=BAND, linewidth=0, zorder=0)
        axes.annotate(
            group,
            (1.0, start),
            xycoords=("axes fraction", "data"),
            xytext=(3, 0),
            textcoords="offset points",
            va="center",
            fontsize=7,
            color=MUTED,
        )
        start = end
