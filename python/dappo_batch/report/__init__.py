"""``dappo-batch report``: runs, sweeps, diagnosers and traces as one HTML page and as figures."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from os import PathLike, fsencode
from pathlib import Path

from dappo_batch._checks import boolean, folder, sequence, text
from dappo_batch._core import ConfigError, write_file
from dappo_batch._extras import require
from dappo_batch.report.sources import Sources, read

__all__ = ["command", "write"]


def write(
    paths: Sequence[str | bytes | PathLike[str]],
    out: str | bytes | PathLike[str] = "report.html",
    *,
    figures: str | bytes | PathLike[str] | None = None,
    csv: str | bytes | PathLike[str] | None = None,
    title: str = "dappo-batch report",
    film_strips: bool = True,
) -> list[Path]:
    """Write a report.

    Parameters
    ----------
    paths : sequence of path-like
        Run folders, folders of ``sweep``, ``diagnose sweep`` and ``diagnose train``, and traces of
        ``adapt --log``.
    out : path-like
        The page.
    figures : path-like, optional
        Folder for the figures as PNG and SVG.
    csv : path-like, optional
        File for the table of all learners, a row for each measure.
    title : str
        Heading of the page.
    film_strips : bool
        Whether to draw moments of an episode of each policy, which takes two seconds for each. Without OpenGL
        or a checkpoint the page contains the reason instead.

    Returns
    -------
    list of Path
        The files that were written, the page first.

    Raises
    ------
    ConfigError
        If a path is of an unknown kind, or the folder of `out` does not exist.
    CheckpointError
        If a file cannot be read.
    MissingExtraError
        If matplotlib is missing.
    """
    page = folder(out, "out")
    title = text(title, "title")
    target = None if figures is None else folder(figures, "figures")
    rows = None if csv is None else folder(csv, "csv")
    paths = [folder(path, "a path") for path in sequence(paths, "paths")]
    for file in (page, *([rows] if rows else [])):
        if not file.parent.is_dir():
            raise ConfigError(f"{file}: there is no folder {file.parent}")
        if file.is_dir():
            raise ConfigError(f"{file} is a folder, expected the name of a file")
    require("report", "reports")
    sources = read(paths)
    html, drawings = _draw(sources, title, target, film_strips=boolean(film_strips, "film_strips"))
    if rows is not None:
        drawings[rows] = _table(sources)
    for path, content in drawings.items():
        _write(path, content)
    _write(page, html)
    return [page, *drawings]


def _draw(
    sources: Sources, title: str, figures: Path | None, *, film_strips: bool
) -> tuple[bytes, dict[Path, bytes]]:
    """Draw the page and files in memory, so that an error leaves no files."""
    # matplotlib belongs to an extra and takes a second to import.
    from dappo_batch.report.page import render
    from dappo_batch.report.picture import style
    from dappo_batch.report.sections import sections

    with style():
        parts = sections(sources, with_strips=film_strips)
        html = render(title, f"dappo-batch {version('dappo-batch')}, {sources.summary()}", parts)
        files = {}
        if figures is not None:
            for picture in (picture for part in parts for picture in part.pictures):
                files[figures / f"{picture.name}.svg"] = picture.svg().encode()
                files[figures / f"{picture.name}.png"] = picture.png()
    return html.encode(), files


def _table(sources: Sources) -> bytes:
    from dappo_batch.report.sections import benchmark_table

    return benchmark_table(sources).encode()


def _write(path: Path, content: bytes) -> None:
    """Write a file atomically."""
    try:
        write_file(path, content)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error}") from error


def _shown(path: str | PathLike[str]) -> str:
    """Return a path as text, replacing bytes that are not UTF-8."""
    return fsencode(path).decode(errors="replace")


def command(
    *,
    paths: Sequence[Path],
    out: Path,
    figures: Path | None,
    csv: Path | None,
    title: str,
    film_strips: bool,
) -> int:
    """Run ``dappo-batch report``, see `write`, and return its exit code."""
    page, *drawn = write(paths, out, figures=figures, csv=csv, title=title, film_strips=film_strips)
    print(f"{_shown(page)} ({page.stat().st_size / 1e6:.1f} MB)")
    if csv is not None:
        print(_shown(drawn.pop()))
    if figures is not None and drawn:
        print(f"{_shown(figures)}: {len(drawn)} files")
    return 0
