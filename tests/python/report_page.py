"""Pages of reports, read as a browser reads them."""

from __future__ import annotations

from base64 import b64decode
from collections.abc import Sequence
from html.parser import HTMLParser
from pathlib import Path

from dappo_batch.report.page import render
from dappo_batch.report.picture import style
from dappo_batch.report.sections import sections
from dappo_batch.report.sources import read

VOID = {"br", "hr", "img", "input", "link", "meta"}


class Page(HTMLParser):
    """Read a page, and check that every element is closed and every anchor unique."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.text = path.read_text(encoding="utf-8")
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.headings: list[str] = []
        self.tables: list[list[list[str]]] = []
        self.flags: list[str] = []
        self.notes: list[str] = []
        self.tiles: list[tuple[str, str]] = []
        self.strips: list[list[bytes]] = []
        self.feed(self.text)
        self.close()
        assert self.open == []
        assert len(self.ids) == len(set(self.ids))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id":
                self.ids.append(str(value))
            elif name in ("href", "xlink:href", "src"):
                self.links.append(str(value))
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("td", "th"):
            self.tables[-1][-1].append("")
        elif tag == "p" and ("class", "note") in attrs:
            self.notes.append("")
        elif tag == "ol":
            self.strips.append([])
        elif tag == "img":
            self.strips[-1].append(b64decode(str(dict(attrs)["src"]).partition(",")[2]))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)
        elif {"td", "th"} & set(self.open):
            self.tables[-1][-1][-1] += data
            if self.open[-1] == "strong":
                self.flags.append(data)
        elif self.open and self.open[-1] == "dt":
            self.tiles.append((data, ""))
        elif self.open and self.open[-1] == "dd":
            self.tiles[-1] = (self.tiles[-1][0], data)
        elif self.open and self.open[-1] == "p" and self.notes and not self.notes[-1]:
            self.notes[-1] = data

    def table(self, *header: str) -> list[dict[str, str]]:
        """Return the rows of the only table with some columns, each by column."""
        (found,) = (table for table in self.tables if set(header) <= set(table[0]))
        return [dict(zip(found[0], row, strict=True)) for row in found[1:]]


def page_of(out: Path, paths: Sequence[Path], *headings: str) -> Page:
    """Write some sections of a report, to save the time of the others, and read them."""
    with style():
        found = sections(read(paths), with_strips=False)
        some = [section for section in found if section.title in headings]
        out.write_text(render("Title", "Subtitle", some), encoding="utf-8")
    return Page(out)
