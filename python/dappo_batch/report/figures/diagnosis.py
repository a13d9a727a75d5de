"""Figures of diagnosers: Table 1 and that of the paper, training, confusion."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator, MaxNLocator
from numpy.typing import NDArray

from dappo_batch.report.picture import HALF, Key, Picture, canvas
from dappo_batch.report.sources import Diagnoser, DiagnoserTest, Table1
from dappo_batch.report.theme import INK, MUTED, WIDTH, mark

__all__ = ["confusion", "epochs", "table1"]

# Opaque colours, for light and dark pages.
_FAINT = LinearSegmentedColormap.from_list("faint", [(*(0.18, 0.55, 0.75), 0.0), (*(0.18, 0.55, 0.75), 0.7)])
_FULL = LinearSegmentedColormap.from_list("full", [(*(0.18, 0.55, 0.75), 0.0), (*(0.18, 0.55, 0.75), 1.0)])
_NAMED = 12
"""Maximum number of classes whose names fit next to a matrix."""


def table1(found: Table1, name: str) -> Picture:
    """Draw the accuracies of a sweep of diagnosers as heat maps, those of the paper next to each."""
    table = found.table
    methods = _levels(table["method"])
    has_paper = "paper_accuracy_pct" in table and bool(np.isfinite(table["paper_accuracy_pct"]).any())
    kinds = [("this run", "accuracy_pct", "sd_pct")]
    kinds += [("paper", "paper_accuracy_pct", "paper_pm_pct")] if has_paper else []
    shown = np.concatenate([table[column] for _, column, _ in kinds])
    low = 10.0 * np.floor(np.nanmin(shown) / 10.0)
    maps = [(method, *kind) for method, kind in product(methods, kinds)]
    rows, columns = _levels(table["timesteps"]), _levels(table["rollouts"])
    height = 0.35 + 0.33 * len(rows)

    def draw(width: float) -> Figure:
        side_by_side = len(maps) if width > 2 * WIDTH else len(kinds)
        down = -(-len(maps) // side_by_side)
        figure, axes = canvas(width, 0.4 + (0.3 + height) * down, down, side_by_side)
        for part, (method, title, column, spread) in zip(axes, maps, strict=True):
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
        return figure

    seeds = table["seeds"]
    several = f"{seeds.min()} to {seeds.max()}" if seeds.min() < seeds.max() else f"{seeds.max()}"
    caption = "Accuracy of the diagnosis in %"
    caption += f", mean ± standard deviation over {several} seeds" if seeds.max() > 1 else ", of one seed"
    caption += ", and that of the paper's Table 1." if has_paper else "."
    return Picture(name, f"Table 1, {found.robot}", caption, draw)


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


def epochs(diagnosers: Sequence[Diagnoser], names: Sequence[str]) -> Picture | None:
    """Draw the share of misclassified validation windows over epochs; None if there are no epochs."""
    curves = [
        (name, diagnoser.epochs["epoch"], 100.0 * (1.0 - diagnoser.epochs[column].astype(np.float64)))
        for name, diagnoser in zip(names, diagnosers, strict=True)
        if (column := "validation_accuracy") in diagnoser.epochs
    ]
    if not curves:
        return None
    marks = [mark(index) for index in range(len(curves))]

    def draw(width: float) -> Figure:
        figure, (axes,) = canvas(width, 2.6)
        for (_, numbers, mistakes), how in zip(curves, marks, strict=True):
            # A logarithmic axis has no zero.
            shown = np.where(mistakes > 0, mistakes, np.nan)
            axes.plot(numbers, shown, how.dash, color=how.colour, marker=how.marker, markersize=3)
        axes.set_yscale("log")
        axes.yaxis.set(major_locator=LogLocator(subs=(1, 2, 5)), major_formatter="{x:g}", minor_formatter="")
        axes.xaxis.set_major_locator(MaxNLocator(integer=True))
        axes.set_xlabel("epoch")
        axes.set_ylabel("misclassified windows, %")
        return figure

    caption = "Share of the validation windows that are misclassified, after each epoch."
    legend = [Key(name, how) for (name, _, _), how in zip(curves, marks, strict=True)]
    return Picture("diagnosers-training", "Training of the diagnosers", caption, draw, legend)


def confusion(test: DiagnoserTest, name: str, title: str) -> Picture:
    """Draw the confusion matrix, as shares of the windows of the true class."""
    totals = test.confusion.sum(axis=1, keepdims=True)
    share = 100.0 * test.confusion / np.maximum(totals, 1.0)
    has_names = len(test.names) <= _NAMED

    def draw(width: float) -> Figure:
        figure, (axes,) = canvas(width, min(width, 5.0))
        image = axes.imshow(share, cmap=_FULL, vmin=0.0, vmax=100.0, interpolation="none")
        if has_names:
            axes.set_xticks(range(len(test.names)), test.names, rotation=90, fontsize=7)
            axes.set_yticks(range(len(test.names)), test.names, fontsize=7)
        axes.set_xlabel("predicted class" if has_names else "predicted class id")
        axes.set_ylabel("true class" if has_names else "true class id")
        axes.grid(visible=False)
        axes.spines[:].set(visible=True, color=MUTED)
        bar = figure.colorbar(image, orientation="horizontal", location="top", shrink=0.6, aspect=30)
        if bar.solids is not None:
            # As a picture instead of 256 rectangles.
            bar.solids.set(rasterized=True)
        bar.set_label("% of the windows of a true class", color=INK, fontsize=8)
        return figure

    caption = f"Predicted and true damage classes of {int(totals.sum())} windows."
    return Picture(name, title, caption, draw, widest=HALF)
