"""The page: one self-contained HTML file."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

from dappo_batch.report.picture import FULL, THIRD, Key, Picture, anchor
from dappo_batch.report.theme import Mark, css_variables, to_variables

__all__ = ["Cell", "Code", "Frame", "Note", "Part", "Section", "Strip", "Text", "Tiles", "Values", "render"]

_ROW = 3
"""Most figures side by side."""


@dataclass(frozen=True)
class Cell:
    """A cell of a table that is more than text.

    Attributes
    ----------
    text : str
        Text.
    mark : Mark or None
        Mark of the learner in figures.
    is_flagged : bool
        Whether the cell is highlighted.
    """

    text: str
    mark: Mark | None = None
    is_flagged: bool = False


@dataclass(frozen=True)
class Values:
    """A table; numbers are formatted and right-aligned. With a title the table is collapsible."""

    header: Sequence[str]
    rows: Sequence[Sequence[str | Cell]]
    title: str = ""


@dataclass(frozen=True)
class Code:
    """Preformatted text, collapsible."""

    title: str
    text: str


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str


@dataclass(frozen=True)
class Note:
    """A highlighted paragraph."""

    text: str


@dataclass(frozen=True)
class Tiles:
    """Main results, each a number with a description."""

    tiles: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Frame:
    """A picture of a strip: a JPEG file and its text."""

    jpeg: bytes
    text: str


@dataclass(frozen=True)
class Strip:
    """Moments of an episode, side by side."""

    title: str
    caption: str
    frames: Sequence[Frame]


Part = Values | Code | Text | Note | Tiles | Strip


@dataclass(frozen=True)
class Section:
    """A part of the page: words and tables first, then figures, then collapsible tables and files.

    Attributes
    ----------
    name, title : str
        Its anchor and its heading.
    parts : sequence of Part
        Paragraphs, tables and files.
    pictures : sequence of Picture
        Figures.
    """

    name: str
    title: str
    parts: Sequence[Part] = ()
    pictures: Sequence[Picture] = ()


def render(title: str, subtitle: str, sections: Sequence[Section]) -> str:
    """Return the page as HTML.

    Parameters
    ----------
    title, subtitle : str
        The heading and the line below it.
    sections : sequence of Section
        In the order of the page.
    """
    links = "\n".join(
        f'<a href="#{anchor(section.name)}">{escape(section.title)}</a>' for section in sections
    )
    return f"""\
<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<meta http-equiv="Content-Security-Policy" content="default-src 'none'; img-src data:; \
style-src 'unsafe-inline'; script-src 'unsafe-inline'">
<link rel="icon" href="data:,">
<title>{escape(title)}</title>
<style>
:root {{ color-scheme: light; {css_variables(dark=False)} }}
:root[data-theme="dark"] {{ color-scheme: dark; {css_variables(dark=True)} }}
@media (prefers-color-scheme: dark) {{
:root:not([data-theme="light"]) {{ color-scheme: dark; {css_variables(dark=True)} }}
}}
{_resource("page.css")}</style>
</head>
<body>
<header>
<div>
<h1>{escape(title)}</h1>
<p class="muted">{escape(subtitle)}</p>
</div>
<button id="theme" type="button" hidden>Dark</button>
</header>
<nav>
{links}
</nav>
<main>
{"".join(_section(section) for section in sections)}</main>
<script>
{_resource("page.js")}</script>
</body>
</html>
"""


def _resource(name: str) -> str:
    return (files("dappo_batch.report") / name).read_text(encoding="utf-8")


def _section(section: Section) -> str:
    open_parts = "".join(_part(part) for part in section.parts if not _folded(part))
    folded = "".join(
        f"<details><summary>{escape(_folded(part))}</summary>{_part(part)}</details>\n"
        for part in section.parts
        if _folded(part)
    )
    heading = f"<h2>{escape(section.title)}</h2>"
    figures = _figures(section.pictures)
    return f'<section id="{anchor(section.name)}">\n{heading}\n{open_parts}{figures}{folded}</section>\n'


def _figures(pictures: Sequence[Picture]) -> str:
    """Return figures in rows that they fill; with one common legend."""
    if not pictures:
        return ""
    first = set(pictures[0].legend)
    sharing = [picture for picture in pictures if picture.legend and first >= set(picture.legend)]
    common = pictures[0].legend if len(sharing) > 1 else ()
    figures = "".join(
        _figure(picture, columns, has_legend=not common or picture not in sharing)
        for row in _rows(pictures)
        for picture, columns in row
    )
    return f'{_legend(common)}<div class="figures">\n{figures}</div>\n'


def _rows(pictures: Sequence[Picture]) -> list[list[tuple[Picture, int]]]:
    """Divide figures into rows of nearly the same number, and the columns of each row among its figures."""
    count = -(-len(pictures) // _ROW)
    rows, start = [], 0
    for number in range(count):
        end = start + -(-(len(pictures) - start) // (count - number))
        row = pictures[start:end]
        columns = [THIRD] * len(row)
        for index, picture in enumerate(row):
            left = FULL - sum(columns)
            # Later figures share the remaining columns.
            takers = [other for other in row[index:] if other.widest > THIRD]
            if picture.widest > THIRD:
                columns[index] = min(picture.widest, THIRD + left // len(takers))
        rows.append(list(zip(row, columns, strict=True)))
        start = end
    return rows


def _figure(picture: Picture, columns: int, *, has_legend: bool) -> str:
    legend = _legend(picture.legend) if has_legend else ""
    caption = f"<figcaption>{escape(picture.caption)}</figcaption>" if picture.caption else ""
    drawing = picture.inline(THIRD)
    if columns != THIRD:
        drawing = f'<div class="wide">{picture.inline(columns)}</div><div class="narrow">{drawing}</div>'
    return (
        f'<figure style="--columns: {columns}">\n<h3>{escape(picture.title)}</h3>\n'
        f"{legend}{drawing}\n{caption}\n</figure>\n"
    )


def _legend(keys: Sequence[Key]) -> str:
    if not keys:
        return ""
    entries = "".join(f"<li>{_swatch(key.mark)}{escape(key.label)}</li>" for key in keys)
    return f'<ul class="legend">{entries}</ul>\n'


_SHAPES = {
    "o": '<circle cx="12" cy="6" r="3.2"/>',
    "s": '<rect x="9" y="3" width="6" height="6"/>',
    "^": '<path d="M12 2l4 7h-8z"/>',
    "D": '<path d="M12 2l4 4-4 4-4-4z"/>',
}
_DASHES = {"-": "", "--": "5 2.5", ":": "1.5 2", "-.": "6 2 1.5 2"}


def _swatch(mark: Mark) -> str:
    """Return a small drawing of how figures draw something."""
    inner = _SHAPES.get(mark.marker, "")
    if mark.dash:
        dash = f'stroke-width="2" stroke-dasharray="{_DASHES[mark.dash]}"'
        inner += f'<path d="M0 6h24" stroke="currentColor" {dash}/>'
    inner = inner or '<rect width="24" height="12" rx="2"/>'
    colour = to_variables(mark.colour)
    return (
        f'<span class="swatch" style="color: {colour}"><svg viewBox="0 0 24 12" fill="currentColor" '
        f'aria-hidden="true">{inner}</svg></span>'
    )


def _part(part: Part) -> str:
    match part:
        case Text(text):
            return f"<p>{escape(text)}</p>\n"
        case Note(text):
            return f'<p class="note">{escape(text)}</p>\n'
        case Code(_, text):
            return f"<pre>{escape(text)}</pre>\n"
        case Values(header, rows):
            return _values(header, rows)
        case Tiles(tiles):
            inner = "".join(
                f"<div><dt>{escape(value)}</dt><dd>{escape(text)}</dd></div>" for value, text in tiles
            )
            return f'<dl class="tiles">{inner}</dl>\n'
        case Strip():
            return _strip(part)


def _folded(part: Part) -> str:
    """Return the summary of a collapsible part; empty for other parts."""
    return part.title if isinstance(part, Values | Code) else ""


def _strip(strip: Strip) -> str:
    frames = "".join(
        f'<li><img src="data:image/jpeg;base64,{b64encode(frame.jpeg).decode()}" alt="">'
        f"<span>{escape(frame.text)}</span></li>"
        for frame in strip.frames
    )
    return (
        f'<figure class="strip">\n<h3>{escape(strip.title)}</h3>\n<ol>{frames}</ol>\n'
        f"<figcaption>{escape(strip.caption)}</figcaption>\n</figure>\n"
    )


def _values(header: Sequence[str], rows: Sequence[Sequence[str | Cell]]) -> str:
    cells = [[cell if isinstance(cell, Cell) else Cell(cell) for cell in row] for row in rows]
    numeric = [all(_is_number(row[index].text) for row in cells) for index in range(len(header))]
    classes = [' class="number"' if number else "" for number in numeric]

    def line(tag: str, contents: Sequence[str]) -> str:
        inner = (f"<{tag}{kind}>{text}</{tag}>" for kind, text in zip(classes, contents, strict=True))
        return f"<tr>{''.join(inner)}</tr>"

    head = line("th", [escape(text) for text in header])
    body = "\n".join(line("td", [_cell(cell) for cell in row]) for row in cells)
    table = f"<table>\n<thead>{head}</thead>\n<tbody>\n{body}\n</tbody>\n</table>"
    return f'<div class="scroll">{table}</div>\n'


def _cell(cell: Cell) -> str:
    text = escape(cell.text)
    if cell.is_flagged:
        text = f'<strong class="flag">{text}</strong>'
    return (_swatch(cell.mark) if cell.mark else "") + text


def _is_number(text: str) -> bool:
    return text in ("n/a", "") or not text.strip("+-±0123456789. %")
