"""``dappo-batch sweep``."""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from dappo_batch.sweeping import sweep
from dappo_batch.sweeping.cell import Cell
from dappo_batch.sweeping.worker import processes

__all__ = ["main"]


def main(argv: Sequence[str]) -> int:
    """Run ``dappo-batch sweep`` and return its exit code.

    Parameters
    ----------
    argv : sequence of str
        The arguments behind ``sweep``.
    """
    parser = argparse.ArgumentParser(
        prog="dappo-batch sweep",
        description="Train every combination of a grid. The same command goes on with what is missing.",
    )
    parser.add_argument("--out", required=True, metavar="DIR", help="folder of the sweep")
    parser.add_argument(
        "--grid",
        nargs="+",
        default=[],
        metavar="KEY=V1,V2",
        help="values of a flag of `train` or of a setting, for example seed=0,1,2 unaware=false,true",
    )
    parser.add_argument(
        "--base", nargs="+", default=[], metavar="KEY=VALUE", help="what all trainings have in common"
    )
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="trainings at once [default: 1]")
    arguments = parser.parse_args(list(argv))
    if arguments.jobs < 1:
        parser.error(f"--jobs must be at least 1, got {arguments.jobs}")
    grid = {key: [_value(part) for part in text.split(",")] for key, text in _pairs(parser, arguments.grid)}
    base = {key: _value(text) for key, text in _pairs(parser, arguments.base)}
    with processes(arguments.jobs) as pool:
        cells = sweep(base, grid, arguments.out, executor=pool, callback=_say)
    out = os.fsencode(arguments.out).decode(errors="replace")
    failed = sum(cell.error is not None for cell in cells)
    print(f"{len(cells) - failed} of {len(cells)} trainings are done; folder of the sweep: {out}")
    return 1 if failed else 0


def _pairs(parser: argparse.ArgumentParser, texts: Sequence[str]) -> Iterator[tuple[str, str]]:
    for text in texts:
        key, equals, value = text.partition("=")
        if not (key and equals and value):
            parser.error(f"`{text}` is no assignment; expected key=value, for example seed=0,1,2")
        yield key, value


def _value(text: str) -> Any:  # noqa: ANN401
    try:
        return json.loads(text)
    except json.JSONDecodeError:
        return text


def _say(cell: Cell) -> None:
    print(f"{cell.path.name}: {cell.error or 'done'}", file=sys.stderr, flush=True)
