"""Figures of damage during an episode: remaining speed or tracking, and single episodes step by step."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from dappo_batch.report.picture import Key, Picture, canvas
from dappo_batch.report.score import Score
from dappo_batch.report.sources import Trace
from dappo_batch.report.theme import BAND, INK, MUTED, PAPER, SERIES, Dash, Mark, mark
from dappo_batch.runs import Run
from dappo_batch.runs.tables import Table

__all__ = ["kept", "shares", "walks"]

_COLUMNS = {"adapted": "with adaptation", "no_adaptation": "without adaptation", "unaware": "without code"}
_SMOOTH = 25  # steps that a speed is averaged over: about a stride
_EVENTS: dict[str, tuple[str, Dash]] = {
    "suspected": ("damage suspected", ":"),
    "adapted": ("diagnosis given to the policy", "--"),
    "withdrawn": ("diagnosis withdrawn", "-."),
}


def shares(table: Table) -> dict[str, float]:
    """Return scores after the damage as shares of the oracle's, ratios of means over the damages.

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


def kept(runs: Sequence[Run], names: Sequence[str], score: Score) -> Picture | None:
    """Draw shares of the oracle's score after the onset; None if they are unknown.

    Parameters
    ----------
    runs : sequence of Run
        Runs with a score in common.
    names : sequence of str
        Their names.
    score : Score
        The score.
    """
    found = [shares(run.adaptation or {}) for run in runs]
    legend = [
        Key(label, Mark(SERIES[index]))
        for index, (column, label) in enumerate(_COLUMNS.items())
        if any(column in one for one in found)
    ]
    if not legend:
        return None
    thickness = 0.2
    group = thickness * (len(legend) + 0.8)

    def draw(width: float) -> Figure:
        figure, (axes,) = canvas(width, 0.7 + group * len(runs))
        for index, key in enumerate(legend):
            column = next(column for column, label in _COLUMNS.items() if label == key.label)
            bars = [(row, 100.0 * one[column]) for row, one in enumerate(found) if column in one]
            place = [row + (index - (len(legend) - 1) / 2) * thickness / group for row, _ in bars]
            drawn = axes.barh(
                place, [share for _, share in bars], 0.9 * thickness / group, color=key.mark.colour
            )
            # The line of the oracle must not cross a number.
            background = {"facecolor": PAPER, "edgecolor": "none", "pad": 0.4}
            axes.bar_label(drawn, fmt="%.0f %%", padding=2, fontsize=7, bbox=background)
        axes.axvline(100.0, color=MUTED, linewidth=1, linestyle="--", zorder=1.5)
        axes.set_yticks(range(len(runs)), names)
        axes.set_ylim(len(runs) - 0.5, -0.5)
        axes.grid(visible=False, axis="y")
        axes.margins(x=0.12)
        axes.set_xlabel(f"% of the oracle's {score.name}")
        return figure

    caption = (
        f"{score.title} from the onset of the damage on, as a share of that of the oracle: the same policy "
        "with the true damage code from the onset on. Ratio of the means over all damage classes."
    )
    # Only a report of robots with and without commands has two such figures.
    file = "adaptation" if score.is_distance else "adaptation-tracking"
    return Picture(file, f"Share of the oracle's {score.name}", caption, draw, legend)


def walks(traces: Sequence[Trace], names: Sequence[str], name: str) -> Picture:
    """Draw episodes with the same damage and score: speed or tracking, onset, events of the controller."""
    first, score = traces[0], traces[0].score
    lines = [Key(own, Mark(mark(index).colour, "-")) for index, own in enumerate(names)]
    happened = [[kind for _, kind in _kinds(trace)] for trace in traces]
    events = [
        Key(label, Mark(INK, dash))
        for kind, (label, dash) in _EVENTS.items()
        if any(kind in kinds for kinds in happened)
    ]
    if first.onset is not None:
        events = [Key("onset of the damage", Mark(INK, "-")), *events]

    def draw(width: float) -> Figure:
        figure, (axes,) = canvas(width, 2.6)
        if first.onset is not None:
            start = float(first.table["step"][first.onset])
            axes.axvspan(start, float(first.table["step"][-1]), color=BAND, linewidth=0, zorder=0)
            axes.axvline(start, color=INK, linewidth=1.2)
        for trace, key in zip(traces, lines, strict=True):
            values = trace.table[score.step_column].astype(np.float64)
            steps = trace.table["step"]
            if len(traces) == 1:
                axes.plot(steps, values, color=key.mark.colour, alpha=0.25, linewidth=0.6)
            axes.plot(steps, _smooth(values), color=key.mark.colour)
            for row, kind in _kinds(trace):
                axes.axvline(
                    float(steps[row]), color=key.mark.colour, linewidth=1, linestyle=_EVENTS[kind][1]
                )
        axes.set_xlabel("env step")
        axes.set_ylabel(f"{score.step_name}, {score.step_unit}")
        axes.set_xlim(0, max(float(trace.table["step"][-1]) for trace in traces))
        return figure

    caption = f"{score.step_name.capitalize()}, mean over the last {_SMOOTH} steps."
    if first.onset is not None:
        caption += f" Shaded: {first.damage} is active, from step {first.table['step'][first.onset]} on."
    if any(happened):
        caption += " Vertical lines, in the colour of their episode: what the controller did."
    return Picture(name, first.damage, caption, draw, (*lines, *events))


def _kinds(trace: Trace) -> list[tuple[int, str]]:
    """Return the events that change what the robot does: the row of a step, and the kind."""
    kinds = [(row, event.split(" ")[0]) for row, event, _ in trace.events()]
    # A change of the class after a withdrawal belongs to the withdrawal.
    withdrawn = {row for row, kind in kinds if kind == "withdrawn"}
    return [
        (row, kind) for row, kind in kinds if kind in _EVENTS and not (kind == "adapted" and row in withdrawn)
    ]


def _smooth(values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Average over the last steps; fewer at the start."""
    sums = np.cumsum(np.concatenate([[0.0], values]))
    ends = np.arange(1, len(values) + 1)
    starts = np.maximum(ends - _SMOOTH, 0)
    smooth: NDArray[np.float64] = (sums[ends] - sums[starts]) / (ends - starts)
    return smooth
