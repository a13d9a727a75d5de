"""Figures of a training: curves over env steps, and throughput."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import EngFormatter

from dappo_batch.report.figures.parts import keys, metres
from dappo_batch.report.learners import Curve, Learner
from dappo_batch.report.picture import Key, Picture, canvas
from dappo_batch.report.theme import INK, SERIES, Mark, mark
from dappo_batch.report.words import grouped_digits

__all__ = ["curves", "throughput"]

_HEIGHT = 2.3
_BAR = 0.4  # in, of a bar with its gap
_AROUND = 0.75  # in, above and below bars


def curves(
    robot: str,
    learners: Sequence[Learner],
    column: str,
    title: str,
    unit: str,
    *,
    weighted: bool,
    over: str = "",
    seconds: float | None = None,
) -> Picture | None:
    """Draw a column of the metrics over training: the mean over seeds, and a band over their range.

    Parameters
    ----------
    robot : str
        Name of the robot.
    learners : sequence of Learner
        Learners to draw.
    column : str
        Name in ``metrics.jsonl``.
    title, unit : str
        Title and unit.
    weighted : bool
        Whether the column is a mean over episodes.
    over : str
        What the column is a mean over, of those with exploration noise.
    seconds : float, optional
        Duration of an env step, s, for a second axis in m; only of forward rewards.

    Returns
    -------
    Picture or None
        None if no learner has the column.
    """
    found = [(learner, learner.curve(column, weighted=weighted)) for learner in learners]
    drawn = [(learner, curve) for learner, curve in found if curve is not None and curve.known.any()]
    if not drawn:
        return None

    def draw(width: float) -> Figure:
        figure, (axes,) = canvas(width, _HEIGHT)
        for learner, curve in drawn:
            _curve(axes, learner, curve)
        axes.set_xlabel("env steps")
        axes.set_ylabel(unit)
        axes.xaxis.set_major_formatter(EngFormatter(sep=""))
        axes.set_xlim(left=0)
        metres(axes, seconds)
        return figure

    caption = f"{title} in training"
    caption += f", of the {over}, with exploration noise." if over else "."
    if any(len(curve.values) > 1 for _, curve in drawn):
        caption += " Lines are means over seeds, bands range from the lowest to the highest seed."
    legend = keys([learner for learner, _ in drawn], lines=True)
    return Picture(f"{robot}-training-{column.replace('_', '-')}", title, caption, draw, legend)


def _curve(axes: Axes, learner: Learner, curve: Curve) -> None:
    steps, values = curve.env_steps[curve.known], curve.values[:, curve.known]
    how = mark(learner.place)
    # A single iteration is a point, which a line would not show.
    marker = "o" if len(steps) == 1 else ""
    axes.plot(steps, values.mean(0), color=how.colour, linestyle=how.dash, marker=marker)
    if len(values) > 1:
        axes.fill_between(steps, values.min(0), values.max(0), color=how.colour, alpha=0.2, linewidth=0)


def throughput(robot: str, learners: Sequence[Learner]) -> Picture:
    """Draw the time of a million env steps of training, split into rollout and update."""
    parts = ("rollout", "update")

    def draw(width: float) -> Figure:
        figure, (axes,) = canvas(width, _AROUND + _BAR * len(learners))
        labels = []
        for row, learner in enumerate(learners):
            millions = np.array(learner.env_steps) / 1e6
            start = 0.0
            for colour, part in zip(SERIES, parts, strict=False):
                spent = [float(np.sum(run.metrics[f"{part}_seconds"])) for run in learner.runs]
                seconds = float((np.array(spent) / millions).mean())
                axes.barh(row, seconds, 0.7, left=start, color=colour)
                start += seconds
            speed = f"{grouped_digits(round(1e6 / start))} env steps/s" if start > 0 else "n/a"
            labels.append(f"{learner.name}\n{speed}")
        axes.set_yticks(range(len(learners)), labels)
        axes.invert_yaxis()
        axes.grid(visible=False, axis="y")
        axes.set_xlabel("seconds for a million env steps", color=INK)
        return figure

    several = " Means over seeds." if any(len(learner.runs) > 1 for learner in learners) else ""
    caption = (
        f"Time of training, without evaluations and start-up.{several} Runs are comparable where they had "
        "the same machine to themselves."
    )
    legend = [Key(part, Mark(colour)) for part, colour in zip(parts, SERIES, strict=False)]
    return Picture(f"{robot}-throughput", f"Time of training, {robot}", caption, draw, legend)
