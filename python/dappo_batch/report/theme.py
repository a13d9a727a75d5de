"""Colours and sizes of figures and page, for light and dark."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

__all__ = [
    "BAND",
    "GRID",
    "INK",
    "LINE",
    "MUTED",
    "PAPER",
    "SERIES",
    "STYLE",
    "WIDTH",
    "Mark",
    "css_variables",
    "mark",
    "to_variables",
]

# Name, colour on light, colour on dark. Light colours must differ: they are what figures are drawn in, and
# in the page each becomes the variable of its name.
_COLOURS = (
    ("paper", "#fefefe", "#181d22"),
    ("ink", "#1c2126", "#e6e9ec"),
    ("muted", "#5b6670", "#a3adb6"),
    ("grid", "#dde2e6", "#343b42"),
    ("band", "#f1f4f6", "#20262c"),
    ("series-0", "#0b6e99", "#4fb3de"),
    ("series-1", "#c2571a", "#f0894a"),
    ("series-2", "#4f7d2a", "#93c766"),
    ("series-3", "#7d4f99", "#bb8fd8"),
    ("series-4", "#a3244f", "#ec6f98"),
    ("series-5", "#766512", "#cdbb4c"),
)
_LIGHT = {name: light for name, light, _ in _COLOURS}
PAPER, INK, MUTED, GRID, BAND = (_LIGHT[name] for name in ("paper", "ink", "muted", "grid", "band"))
SERIES = tuple(light for name, light, _ in _COLOURS if name.startswith("series"))
"""Colours of lines and bars; with more of them than this, colours repeat."""

WIDTH = 4.0
"""Width of a figure in a file, in: a phone shows it in about this size, so that text stays readable."""

LINE = 0.17
"""Height of a line of a legend, in."""

Dash: TypeAlias = Literal["", "-", "--", "-.", ":"]

_DASHES: tuple[Dash, ...] = ("-", "--", ":")
_MARKERS = ("o", "s", "^", "D")


@dataclass(frozen=True)
class Mark:
    """How something is drawn: a colour, and a line, a marker, both, or (with neither) an area.

    Attributes
    ----------
    colour : str
        One of the colours above.
    dash : str
        Matplotlib's name of a line style; empty for no line.
    marker : str
        Matplotlib's name of a marker; empty for none.
    """

    colour: str
    dash: Dash = ""
    marker: str = ""


def mark(place: int) -> Mark:
    """Return the mark of something by its place; the first 72 differ."""
    turn = place // len(SERIES)
    return Mark(SERIES[place % len(SERIES)], _DASHES[turn % len(_DASHES)], _MARKERS[turn % len(_MARKERS)])


STYLE: Any = {
    "axes.axisbelow": True,
    "axes.edgecolor": MUTED,
    "axes.facecolor": "none",
    "axes.grid": True,
    "axes.labelcolor": INK,
    "axes.labelsize": 9,
    "axes.spines.right": False,
    "axes.spines.top": False,
    "axes.titlesize": 9,
    "axes.titlecolor": INK,
    "figure.constrained_layout.use": True,
    "figure.facecolor": PAPER,
    "font.family": "DejaVu Sans",
    "font.size": 9,
    "grid.color": GRID,
    "grid.linewidth": 0.6,
    "legend.fontsize": 8,
    "legend.frameon": False,
    "lines.linewidth": 1.6,
    "savefig.facecolor": PAPER,
    # Text stays text: small, searchable, and in the font of the page.
    "svg.fonttype": "none",
    # The same figure is the same file.
    "svg.hashsalt": "dappo-batch",
    "text.color": INK,
    # A dollar sign in a name does not start a formula.
    "text.parse_math": False,
    "xtick.color": MUTED,
    "xtick.labelcolor": INK,
    "xtick.labelsize": 8,
    "ytick.color": MUTED,
    "ytick.labelcolor": INK,
    "ytick.labelsize": 8,
}


def css_variables(*, dark: bool) -> str:
    """Return the colours as declarations of CSS variables."""
    return " ".join(f"--{name}: {shade if dark else light};" for name, light, shade in _COLOURS)


def to_variables(svg: str) -> str:
    """Replace the colours of a drawing by CSS variables."""
    for name, light, _ in _COLOURS:
        svg = svg.replace(light, f"var(--{name})")
    return svg
