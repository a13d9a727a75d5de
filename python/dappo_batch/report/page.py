"""The page: one HTML file that needs nothing else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from importlib.resources import files

from dappo_batch.report.picture import Picture, anchor
from dappo_batch.report.theme import css_variables

__all__ = ["Code", "Part", "Section", "Text", "Values", "render"]


@dataclass(frozen=True)
class Values:
    """A table; numbers are formatted already, and stand at the right. With a title it is folded in."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]
    title: str = ""


@dataclass(frozen=True)
class Code:
    """Text as it is in a file, folded in."""

    title: str
    text: str


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str


Part = Values | Code | Text


@dataclass(frozen=True)
class Section:
    """A part of the page: words and tables first, then figures, then tables and files that are folded in.

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
    open_parts = "".join(_part(part) for part in section.parts if not _title(part))
    folded = "".join(
        f"<details><summary>{escape(_title(part))}</summary>{_part(part)}</details>\n"
        for part in section.parts
        if _title(part)
    )
    figures = "".join(map(_figure, section.pictures))
    if figures:
        figures = f'<div class="figures">\n{figures}</div>\n'
    heading = f"<h2>{escape(section.title)}</h2>"
    return f'<section id="{anchor(section.name)}">\n{heading}\n{open_parts}{figures}{folded}</section>\n'


def _figure(picture: Picture) -> str:
    caption = f"<figcaption>{escape(picture.caption)}</figcaption>"
    return f"<figure>\n<h3>{escape(picture.title)}</h3>\n{picture.inline()}\n{caption}\n</figure>\n"


def _part(part: Part) -> str:
    match part:
        case Text(text):
            return f"<p>{escape(text)}</p>\n"
        case Code(_, text):
            return f"<pre>{escape(text)}</pre>\n"
        case Values(header, rows):
            return _values(header, rows)


def _title(part: Part) -> str:
    """Return what a part is folded in under; nothing for one that is not."""
    return "" if isinstance(part, Text) else part.title


def _values(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    numeric = [all(_is_number(row[index]) for row in rows) for index in range(len(header))]

    def line(tag: str, cells: Sequence[str]) -> str:
        marks = [' class="number"' if number else "" for number in numeric]
        inner = "".join(
            f"<{tag}{mark}>{escape(cell)}</{tag}>" for mark, cell in zip(marks, cells, strict=True)
        )
        return f"<tr>{inner}</tr>"

    body = "\n".join(line("td", row) for row in rows)
    head = line("th", header)
    return f'<div class="scroll"><table>\n<thead>{head}</thead>\n<tbody>\n{body}\n</tbody>\n</table></div>\n'


def _is_number(text: str) -> bool:
    return text == "n/a" or not text.strip("+-0123456789. %")
