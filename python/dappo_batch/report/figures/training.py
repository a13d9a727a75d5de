"""Figures of a training: curves over env steps, and how fast it was."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import EngFormatter

from dappo_batch.report.learners import Learner
from dappo_batch.report.picture import Picture, canvas, legend
from dappo_batch.report.theme import INK, LINE, SERIES

__all__ = ["curves", "throughput"]

_HEIGHT = 2.2
_BAR = 0.34  # in, of a bar with its gap
_AROUND = 0.9  # in, above and below bars


def curves(
    robot: str, learners: Sequence[Learner], column: str, title: str, unit: str, *, weighted: bool
) -> Picture | None:
    """Draw a column of the metrics over training: the mean over seeds, and a band over their range.

    Parameters
    ----------
    robot : str
        Name of the robot.
    learners : sequence of Learner
        Who to draw.
    column : str
        Name in ``metrics.jsonl``.
    title, unit : str
        What it is and what it is measured in.
    weighted : bool
        Whether the column is a mean over episodes.

    Returns
    -------
    Picture or None
        None if no learner has the column.
    """
    figure, (axes,) = canvas(_HEIGHT + LINE * len(learners))
    drawn = [_curve(axes, learner, column, weighted) for learner in learners]
    if not any(drawn):
        return None
    axes.set_xlabel("env steps")
    axes.set_ylabel(unit)
    axes.xaxis.set_major_formatter(EngFormatter(sep=""))
    axes.set_xlim(left=0)
    legend(figure)
    caption = f"{title} in training; lines are means over seeds, bands reach from the lowest to the highest."
    if weighted:
        caption += " Episodes that ended in training, with exploration noise."
    return Picture(f"{robot}-training-{column.replace('_', '-')}", title, caption, figure)


def _curve(axes: Axes, learner: Learner, column: str, weighted: bool) -> bool:
    curve = learner.curve(column, weighted=weighted)
    if curve is None:
        return False
    known = np.isfinite(curve.values).all(axis=0)
    if not known.any():
        return False
    steps, values = curve.env_steps[known], curve.values[:, known]
    colour = SERIES[learner.place % len(SERIES)]
    # A single iteration is a point, which a line would not show.
    marker = "o" if len(steps) == 1 else ""
    dash = "-" if learner.place < len(SERIES) else "--"
    axes.plot(steps, values.mean(0), color=colour, linestyle=dash, marker=marker, label=learner.label())
    if len(values) > 1:
        axes.fill_between(steps, values.min(0), values.max(0), color=colour, alpha=0.2, linewidth=0)
    return True


def throughput(robot: str, learners: Sequence[Learner]) -> Picture:
    """Draw how long a million env steps of training took, and where the time went."""
    figure, (axes,) = canvas(_AROUND + _BAR * len(learners))
    names = []
    for row, learner in enumerate(learners):
        steps = np.array([float(run.metrics["env_steps"][-1]) for run in learner.runs]) / 1e6
        parts = [
            np.array([float(np.sum(run.metrics[column])) for run in learner.runs]) / steps
            for column in ("rollout_seconds", "update_seconds")
        ]
        rollout, update = (float(part.mean()) for part in parts)
        axes.barh(row, rollout, 0.7, color=SERIES[0], label="rollout" if row == 0 else None)
        bar = axes.barh(row, update, 0.7, left=rollout, color=SERIES[1], label="update" if row == 0 else None)
        speed = f"{1e6 / (rollout + update):,.0f} steps/s".replace(",", " ")
        axes.bar_label(bar, [speed], padding=3, fontsize=8)
        names.append(learner.name)
    axes.set_yticks(range(len(names)), names)
    axes.invert_yaxis()
    axes.grid(visible=False, axis="y")
    axes.margins(x=0.3)
    axes.set_xlabel("seconds for a million env steps", color=INK)
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    caption = (
        "Without evaluations and start-up; means over seeds. Runs are comparable where "
        "they had the same machine to themselves."
    )
    return Picture(f"{robot}-throughput", f"Time of training, {robot}", caption, figure)
