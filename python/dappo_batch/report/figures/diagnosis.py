"""Figures of diagnosers: Table 1 beside the paper's, training, confusion."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.ticker import LogLocator
from numpy.typing import NDArray

from dappo_batch.report.picture import Picture, canvas, legend
from dappo_batch.report.sources import Diagnoser, DiagnoserTest, Sweep
from dappo_batch.report.theme import INK, LINE, MUTED, SERIES

__all__ = ["confusion", "epochs", "table1"]

# Nothing is transparent, so that one picture suits a light and a dark page; text stays readable on most.
_FAINT = LinearSegmentedColormap.from_list("faint", [(*(0.18, 0.55, 0.75), 0.0), (*(0.18, 0.55, 0.75), 0.7)])
_FULL = LinearSegmentedColormap.from_list("full", [(*(0.18, 0.55, 0.75), 0.0), (*(0.18, 0.55, 0.75), 1.0)])
_NAMED = 12
"""Most classes whose names fit beside a matrix."""


def table1(sweep: Sweep, name: str) -> Picture:
    """Draw the accuracies of a sweep as heat maps, a row for each method, beside the paper's."""
    table = sweep.table
    methods = _levels(table["method"])
    has_paper = "paper_accuracy_pct" in table and bool(np.isfinite(table["paper_accuracy_pct"]).any())
    kinds = [("this run", "accuracy_pct", "sd_pct")]
    kinds += [("paper", "paper_accuracy_pct", "paper_pm_pct")] if has_paper else []
    figure, axes = canvas(0.5 + 1.75 * len(methods), len(methods), len(kinds))
    shown = np.concatenate([table[column] for _, column, _ in kinds])
    low = 10.0 * np.floor(np.nanmin(shown) / 10.0)
    for part, (method, (title, column, spread)) in zip(axes, product(methods, kinds), strict=True):
        rows, columns = _levels(table["timesteps"]), _levels(table["rollouts"])
        accuracy, spreads = (np.full((len(rows), len(columns)), np.nan) for _ in range(2))
        for index in np.flatnonzero(table["method"] == method):
            cell = rows.index(table["timesteps"][index]), columns.index(table["rollouts"][index])
            accuracy[cell], spreads[cell] = table[column][index], table[spread][index]
        _heat_map(part, accuracy, spreads, low)
        part.set_title(f"method {method}, {title}")
        part.set_xticks(range(len(columns)), columns)
        part.set_yticks(range(len(rows)), rows)
    figure.supxlabel("rollouts", fontsize=9)
    figure.supylabel("steps of a window", fontsize=9)
    seeds = table["seeds"]
    several = f"{seeds.min()} to {seeds.max()}" if seeds.min() < seeds.max() else f"{seeds.max()}"
    caption = f"Accuracy of the diagnosis in %, mean ± standard deviation over {several} seeds"
    caption += ", beside the paper's Table 1." if has_paper else "."
    return Picture(name, f"Table 1, {sweep.robot}", caption, figure)


def _levels(column: NDArray[Any]) -> list[Any]:
    return list(dict.fromkeys(column.tolist()))


def _heat_map(axes: Axes, accuracy: NDArray[np.float64], spread: NDArray[np.float64], low: float) -> None:
    axes.imshow(accuracy, cmap=_FAINT, vmin=low, vmax=100.0, aspect="auto", interpolation="none")
    for (row, column), value in np.ndenumerate(accuracy):
        if np.isfinite(value):
            axes.text(column, row - 0.12, f"{value:.2f}", ha="center", va="center", fontsize=8)
        if np.isfinite(spread[row, column]):
            small = f"±{spread[row, column]:.2f}"
            axes.text(column, row + 0.26, small, ha="center", va="center", fontsize=6.5)
    _bare(axes)


def _bare(axes: Axes) -> None:
    axes.grid(visible=False)
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


def epochs(diagnosers: Sequence[Diagnoser]) -> Picture | None:
    """Draw the share of mistakes on validation windows over epochs; None if there are no epochs."""
    figure, (axes,) = canvas(2.2 + LINE * len(diagnosers))
    drawn = False
    for index, diagnoser in enumerate(diagnosers):
        if "validation_accuracy" not in diagnoser.epochs:
            continue
        mistakes = 100.0 * (1.0 - diagnoser.epochs["validation_accuracy"].astype(np.float64))
        dash = "-" if index < len(SERIES) else "--"
        colour = SERIES[index % len(SERIES)]
        label = diagnoser.path.name
        # A logarithmic axis has no place for none at all.
        shown = np.where(mistakes > 0, mistakes, np.nan)
        axes.plot(diagnoser.epochs["epoch"], shown, dash, color=colour, marker=".", label=label)
        drawn = True
    if not drawn:
        return None
    axes.set_yscale("log")
    axes.yaxis.set(major_locator=LogLocator(subs=(1, 2, 5)), major_formatter="{x:g}", minor_formatter="")
    axes.set_xlabel("epoch")
    axes.set_ylabel("mistakes, % of windows")
    legend(figure)
    caption = "Share of the validation windows that were named wrongly, after each epoch."
    return Picture("diagnosers-training", "Training of the diagnosers", caption, figure)


def confusion(test: DiagnoserTest, name: str, title: str) -> Picture:
    """Draw which class was named as which, as shares of the true class."""
    totals = test.confusion.sum(axis=1, keepdims=True)
    share = 100.0 * test.confusion / np.maximum(totals, 1.0)
    figure, (axes,) = canvas(3.9)
    image = axes.imshow(share, cmap=_FULL, vmin=0.0, vmax=100.0, interpolation="none")
    if len(test.names) <= _NAMED:
        axes.set_xticks(range(len(test.names)), test.names, rotation=90, fontsize=7)
        axes.set_yticks(range(len(test.names)), test.names, fontsize=7)
    axes.set_xlabel("named" if len(test.names) <= _NAMED else "named class")
    axes.set_ylabel("true" if len(test.names) <= _NAMED else "true class")
    axes.grid(visible=False)
    axes.spines[:].set(visible=True, color=MUTED)
    bar = figure.colorbar(image, orientation="horizontal", location="top", shrink=0.6, aspect=30)
    if bar.solids is not None:
        # A picture and not 256 rectangles.
        bar.solids.set(rasterized=True)
    bar.set_label("% of the windows of a true class", color=INK, fontsize=8)
    caption = f"Which damage class is named in windows of which, {int(totals.sum())} windows."
    return Picture(name, title, caption, figure)
