"""A figure with title, caption and legend, as a file or part of the page."""

from __future__ import annotations

import io
import re
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass
from html import escape

import matplotlib
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from dappo_batch.report.theme import LINE, STYLE, WIDTH, Mark, to_variables

__all__ = ["FULL", "HALF", "THIRD", "Key", "Picture", "anchor", "canvas", "drawn_width", "style"]

_DPI = 300  # of PNG files: what journals ask for
_LETTERS = 48  # of names that fit into the width of a file, with their marks
_MARK = 5  # letters that a mark is as wide as

THIRD, HALF, FULL = 4, 6, 12
"""Widths in a page, of 12 columns."""


@dataclass(frozen=True)
class Key:
    """An entry of a legend."""

    label: str
    mark: Mark

    def artist(self) -> Artist:
        """Return its matplotlib handle."""
        colour, dash, marker = self.mark.colour, self.mark.dash, self.mark.marker
        if not dash and not marker:
            return Patch(color=colour, label=self.label)
        line = Line2D([], [], color=colour, linestyle=dash, marker=marker, label=self.label)
        line.set_markersize(4)
        return line


@dataclass(frozen=True)
class Picture:
    """A figure.

    Attributes
    ----------
    name : str
        Name of its files, without ending.
    title, caption : str
        Title and caption; an empty caption is omitted.
    draw : function
        Function from a width, in, to the drawing, without a legend.
    legend : sequence of Key
        Entries of the legend, above the figure in a page and below the axes in a file.
    widest : int
        Maximum width in a page, in columns of 12.
    """

    name: str
    title: str
    caption: str
    draw: Callable[[float], Figure]
    legend: Sequence[Key] = ()
    widest: int = FULL

    def png(self) -> bytes:
        """Draw into a PNG file."""
        file = io.BytesIO()
        self._for_a_file().savefig(file, format="png", dpi=_DPI, metadata={"Software": None})
        return file.getvalue()

    def svg(self) -> str:
        """Draw into an SVG file; the same figure gives the same text."""
        return _svg(self._for_a_file())

    def inline(self, columns: int) -> str:
        """Draw into an element for a page that has many figures, in colours that follow the page's."""
        svg = _svg(self.draw(drawn_width(columns)))
        # The page determines the size.
        head, rest = svg[svg.index("<svg") :].split(">", 1)
        head = re.sub(r' (width|height|version|xmlns(:xlink)?)="[^"]*"', "", head)
        head += f' role="img" aria-label="{escape(self.title)}"'
        # Names of parts are unique in a page, not only in a figure.
        rest = re.sub(r'(?<= id=")|(?<=url\(#)|(?<=href="#)', f"{anchor(self.name)}-{columns}-", rest)
        return to_variables(f"{head}>{rest}")

    def _for_a_file(self) -> Figure:
        """Draw it with its legend."""
        figure = self.draw(WIDTH)
        if self.legend:
            longest = max(len(key.label) for key in self.legend) + _MARK
            columns = max(1, min(len(self.legend), _LETTERS // longest))
            figure.set_figheight(figure.get_figheight() + LINE * (1 + -(-len(self.legend) // columns)))
            handles = [key.artist() for key in self.legend]
            figure.legend(handles=handles, loc="outside lower center", ncols=columns)
        return figure


def _svg(figure: Figure) -> str:
    file = io.StringIO()
    # Without date and program, so that equal figures are equal files.
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    figure.savefig(file, format="svg", metadata=nothing)
    return file.getvalue()


def drawn_width(columns: int) -> float:
    """Return the width of a drawing, in, that a page shows in so many columns with text of the same size."""
    column, gap = 69.3, 32.0  # in pixels, of the widest page
    third = THIRD * column + (THIRD - 1) * gap
    return WIDTH * (columns * column + (columns - 1) * gap) / third


def anchor(name: str) -> str:
    """Return a name as HTML and URLs allow it."""
    return re.sub(r"[^a-zA-Z0-9_-]", "-", name)


def style() -> AbstractContextManager[None]:
    """Return a context in which figures are drawn and written."""
    return matplotlib.rc_context(STYLE)


def canvas(width: float, height: float, rows: int = 1, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """Return an empty figure of a width and height, in, and a grid of axes, row by row."""
    figure = Figure(figsize=(width, height))
    axes = figure.subplots(rows, columns, squeeze=False)
    return figure, list(axes.flat)
