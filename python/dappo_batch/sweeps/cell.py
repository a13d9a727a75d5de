"""The cells of a sweep: names, folders and options."""

from __future__ import annotations

import itertools
import json
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dappo_batch._checks import mapping, sequence, shown, text
from dappo_batch._core import ConfigError
from dappo_batch.commands import TrainingOptions
from dappo_batch.commands.options import FLAGS
from dappo_batch.runs import Run, load_run

__all__ = ["Cell", "cells_of", "options_of"]

MOST_CELLS = 10**6
_OPTIONS = frozenset(TrainingOptions.__annotations__)


@dataclass(frozen=True)
class Cell:
    """One training of a sweep.

    Attributes
    ----------
    values : mapping
        A value for each key of the grid.
    path : Path
        The run folder.
    error : str or None
        The error, if it failed.
    """

    values: Mapping[str, Any]
    path: Path
    error: str | None = None

    def run(self) -> Run:
        """Read the run folder; see `load_run`."""
        return load_run(self.path)


def cells_of(grid: Mapping[str, Sequence[Any]], folder: Path) -> Iterator[Cell]:
    """Yield every combination of the grid, the last key changing first."""
    for key, values in mapping(grid, "grid").items():
        text(key, "a key of the grid")
        sequence(values, f"the grid's values of {key}")
    if empty := [key for key, values in grid.items() if not len(values)]:
        raise ConfigError(f"the grid has no values for {', '.join(empty)}")
    if math.prod(len(values) for values in grid.values()) > MOST_CELLS:
        raise ConfigError(f"the grid has more than {MOST_CELLS} cells")
    seen = set()
    for values in itertools.product(*grid.values()):
        cell = dict(zip(grid, values, strict=True))
        name = ",".join(f"{key}={_name(value)}" for key, value in cell.items()) or "run"
        if name in seen:
            raise ConfigError(f"two cells of the grid have the name {name}")
        seen.add(name)
        yield Cell(cell, folder / name)


def _name(value: Any) -> str:  # noqa: ANN401 - any setting
    try:
        name = value if isinstance(value, str) else json.dumps(value)
    except (TypeError, ValueError, RecursionError):
        raise ConfigError(f"the grid has an invalid value: {shown(value)}") from None
    return re.sub(r"[^\w.+-]", "_", name)


def options_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return options of `train`, with all other settings in its option `set`; names may be those of flags.

    Raises
    ------
    ConfigError
        If an option is given by both names.
    """
    if twice := [name for flag, name in FLAGS.items() if {flag, name} <= values.keys()]:
        raise ConfigError(f"{twice[0]} is given twice, also by the name of its flag")
    values = {FLAGS.get(key, key): value for key, value in values.items()}
    options = {key: value for key, value in values.items() if key in _OPTIONS}
    settings = {key: value for key, value in values.items() if key not in _OPTIONS}
    given = mapping(options.get("set") or {}, "set")
    return options | ({"set": {**given, **settings}} if settings else {})
