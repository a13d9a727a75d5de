"""A figure with its words, and how it becomes a file or a part of the page."""

from __future__ import annotations

import io
import re
from contextlib import AbstractContextManager
from dataclasses import dataclass
from functools import cached_property
from html import escape
from typing import Literal

import matplotlib
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from dappo_batch.report.theme import STYLE, WIDTH, to_variables

__all__ = ["Picture", "anchor", "canvas", "legend", "style"]

_DPI = 300  # of PNG files: what journals ask for
_SHORT = 22  # most letters of a name that has half of the width


@dataclass(frozen=True)
class Picture:
    """A figure.

    Attributes
    ----------
    name : str
        Name of its files, without ending.
    title, caption : str
        What it shows, in short and in a sentence or two.
    figure : matplotlib.figure.Figure
        The drawing.
    """

    name: str
    title: str
    caption: str
    figure: Figure

    def png(self) -> bytes:
        """Draw into a PNG file."""
        file = io.BytesIO()
        self.figure.savefig(file, format="png", dpi=_DPI, metadata={"Software": None})
        return file.getvalue()

    @cached_property
    def svg(self) -> str:
        """The figure as an SVG file; the same figure gives the same text."""
        file = io.StringIO()
        # Whoever reads the file need not know when and by what it was drawn.
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        self.figure.savefig(file, format="svg", metadata=nothing)
        return file.getvalue()

    def inline(self) -> str:
        """Draw into an element for a page that has many figures, in colours that follow the page's."""
        svg = self.svg[self.svg.index("<svg") :]
        # The page decides how large it is shown.
        head, rest = svg.split(">", 1)
        head = re.sub(r' (width|height|version|xmlns(:xlink)?)="[^"]*"', "", head)
        head += f' role="img" aria-label="{escape(self.title)}"'
        # Names of parts are unique in a page, not only in a figure.
        rest = re.sub(r'(?<= id=")|(?<=url\(#)|(?<=href="#)', f"{anchor(self.name)}-", rest)
        return to_variables(f"{head}>{rest}")


def anchor(name: str) -> str:
    """Return a name as HTML and URLs allow it."""
    return re.sub(r"[^a-zA-Z0-9_-]", "-", name)


def style() -> AbstractContextManager[None]:
    """Return a context in which figures are drawn and written."""
    return matplotlib.rc_context(STYLE)


def legend(
    figure: Figure,
    place: Literal["outside upper center", "outside lower center"] = "outside upper center",
) -> None:
    """Name what is drawn outside of the axes, in two columns where the names are short enough."""
    names = figure.axes[0].get_legend_handles_labels()[1]
    short = all(len(name) <= _SHORT for name in names)
    figure.legend(loc=place, ncols=2 if short else 1)


def canvas(height: float, rows: int = 1, columns: int = 1) -> tuple[Figure, list[Axes]]:
    """Return an empty figure of the common width and its axes, row by row.

    Parameters
    ----------
    height : float
        Height, in.
    rows, columns : int
        Grid of axes.
    """
    figure = Figure(figsize=(WIDTH, height))
    axes = figure.subplots(rows, columns, squeeze=False)
    return figure, list(axes.flat)
