"""Figures of damage in mid-walk: what is kept of the walk, and single walks step by step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from numpy.typing import NDArray

from dappo_batch.report.picture import Picture, canvas, legend
from dappo_batch.report.sources import Trace
from dappo_batch.report.theme import INK, MUTED, PAPER, SERIES
from dappo_batch.runs import Run
from dappo_batch.runs.tables import Table

__all__ = ["kept", "shares", "walks"]

_COLUMNS = {"adapted": "adapted", "unadapted": "no adaptation", "unaware": "PPO-Unaware"}
_SMOOTH = 25  # steps that a speed is averaged over: about a stride
_WORDS = {"suspected": "suspected", "adapted": "told", "withdrawn": "withdrawn"}


def shares(table: Table) -> dict[str, float]:
    """Return forward rewards after the damage as shares of the oracle's, ratios of means over the damages.

    Columns without a number are left out.
    """
    damaged = table["class"] != 0
    oracle = float(np.sum(table["oracle"][damaged]))
    found = {}
    for column in _COLUMNS:
        if column in table and table[column].dtype.kind in "if":
            total = float(np.sum(table[column][damaged]))
            if np.isfinite(total) and oracle > 0:
                found[column] = total / oracle
    return found


def kept(runs: Sequence[Run], labels: Sequence[str]) -> Picture:
    """Draw what is kept of the oracle's forward reward after the damage, a group of bars for each run."""
    thickness, group = 0.17, 0.17 * 3.8
    figure, (axes,) = canvas(0.9 + group * len(runs))
    for index, (column, label) in enumerate(_COLUMNS.items()):
        found = [(row, shares(run.adaptation or {}).get(column)) for row, run in enumerate(runs)]
        bars = [(row, 100.0 * share) for row, share in found if share is not None]
        place = [row + (index - 1) * thickness / group for row, _ in bars]
        widths = [width for _, width in bars]
        if bars:
            drawn = axes.barh(place, widths, 0.9 * thickness / group, color=SERIES[index], label=label)
            # The line of the oracle must not cross a number.
            background = {"facecolor": PAPER, "edgecolor": "none", "pad": 0.4}
            axes.bar_label(drawn, fmt="%.0f", padding=2, fontsize=7, bbox=background)
    axes.axvline(100.0, color=MUTED, linewidth=1, linestyle="--", zorder=1.5)
    axes.set_yticks(range(len(runs)), labels)
    axes.set_ylim(len(runs) - 0.5, -0.5)
    axes.grid(visible=False, axis="y")
    axes.margins(x=0.1)
    axes.set_xlabel("% of the oracle's forward reward")
    figure.legend(loc="outside upper center", ncols=3)
    caption = (
        "Forward reward from the damage on, as a share of that of the same policy told the truth at once "
        "(the oracle); ratio of means over all damages."
    )
    return Picture("adaptation", "What is kept of the walk", caption, figure)


def walks(traces: Sequence[Trace], name: str) -> Picture:
    """Draw speeds of walks with the same damage, the damage and what the controller did about it."""
    figure, (axes,) = canvas(2.9)
    first = traces[0]
    for index, trace in enumerate(traces):
        colour = SERIES[index % len(SERIES)]
        speed = trace.table["forward_velocity"].astype(np.float64)
        steps = trace.table["step"]
        if len(traces) == 1:
            axes.plot(steps, speed, color=colour, alpha=0.25, linewidth=0.6)
        axes.plot(steps, _smooth(speed), color=colour, label=trace.path.stem)
    marks = [] if first.onset is None else [(first.onset, "damage", INK)]
    for index, trace in enumerate(traces):
        colour = SERIES[index % len(SERIES)]
        marks += [(row, word, colour) for row, word in _words(trace)]
    _mark(axes, [(float(first.table["step"][row]), word, colour) for row, word, colour in sorted(marks)])
    axes.set_xlabel("env step")
    axes.set_ylabel("forward velocity, m/s")
    axes.set_xlim(left=0)
    if len(traces) > 1:
        legend(figure, "outside lower center")
    struck = "" if first.onset is None else f", {first.damage} from step {first.onset} on"
    caption = f"Forward velocity, mean of {_SMOOTH} steps{struck}. "
    caption += "Dashed lines: when the damage struck, and what the controller did."
    return Picture(name, first.damage, caption, figure)


def _words(trace: Trace) -> list[tuple[int, str]]:
    """Return the events that change what the robot does, in short."""
    kinds = [(row, event.split(" ")[0]) for row, event, _ in trace.events()]
    return [(row, _WORDS[kind]) for row, kind in kinds if kind in _WORDS]


def _mark(axes: Axes, marks: Sequence[tuple[float, str, str]]) -> None:
    """Draw vertical lines with words above each other, so that close ones do not overlap."""
    for number, (step, word, colour) in enumerate(marks):
        axes.axvline(step, color=colour, linewidth=0.9, linestyle=(0, (3, 2)))
        axes.annotate(
            word,
            (step, 1.0),
            xycoords=("data", "axes fraction"),
            xytext=(3, 4 + 10 * (len(marks) - 1 - number)),
            textcoords="offset points",
            color=colour,
            fontsize=8,
        )


def _smooth(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Average over the last steps; fewer at the start."""
    sums = np.cumsum(np.concatenate([[0.0], values]))
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - _SMOOTH, 0)
    smooth: NDArray[np.float64] = (sums[ends] - sums[starts]) / (ends - starts)
    return smooth
