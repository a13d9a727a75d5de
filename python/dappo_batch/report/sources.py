"""Inputs of a report: paths, whose kind is recognised by their content."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from os import PathLike, fsdecode
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dappo_batch._core import CheckpointError, ConfigError
from dappo_batch.report.score import TRACKING, Score, score_of_trace
from dappo_batch.runs import Run, load_run
from dappo_batch.runs.run import read_lines, read_toml
from dappo_batch.runs.tables import Table, columns, read_csv, read_text

__all__ = ["Diagnoser", "DiagnoserTest", "Outside", "Sources", "Table1", "Trace", "read"]

_TABLE1 = ("robot", "timesteps", "method", "rollouts", "seeds", "accuracy_pct", "sd_pct")
_TRACE = ("step", "forward_velocity", "damage", "assumed", "event")
_EXPECTED = (
    "expected a run folder, a folder of `sweep`, `evaluate --act`, `diagnose train` or `diagnose sweep`, "
    "or a trace of `adapt --log`"
)


@dataclass(frozen=True)
class Table1:
    """Accuracies of a sweep of diagnosers, cell by cell, with the paper's."""

    path: Path
    robot: str
    table: Table


@dataclass(frozen=True)
class DiagnoserTest:
    """A diagnoser on one dataset.

    Attributes
    ----------
    data : str
        Name of the dataset; ``validation`` for the validation rollouts of the training.
    summary : mapping
        Accuracy, its standard error and calibration error, shares from 0 to 1; may be empty.
    names : tuple of str
        Damage classes, C.
    confusion : float64[C, C]
        Windows of the class of a row for which that of a column was predicted.
    """

    data: str
    summary: Mapping[str, Any]
    names: tuple[str, ...]
    confusion: NDArray[np.float64]


@dataclass(frozen=True)
class Diagnoser:
    """A trained diagnoser: its settings, an entry an epoch, and its tests."""

    path: Path
    config: Mapping[str, Any]
    epochs: Table
    tests: tuple[DiagnoserTest, ...]


@dataclass(frozen=True)
class Trace:
    """One episode, an entry a step."""

    path: Path
    table: Table

    @property
    def onset(self) -> int | None:
        """Row of the first step with damage; None of a robot that stays healthy."""
        damaged = np.flatnonzero(self.table["damage"] != "healthy")
        return int(damaged[0]) if len(damaged) else None

    @property
    def score(self) -> Score:
        """What episodes are compared by."""
        return score_of_trace(self.table)

    @property
    def damage(self) -> str:
        """Damage at the end."""
        return str(self.table["damage"][-1])

    def events(self) -> list[tuple[int, str, str]]:
        """Return the events: the row of a step, the event, and the assumed class."""
        found = []
        for row, (events, assumed) in enumerate(zip(self.table["event"], self.table["assumed"], strict=True)):
            found += [(row, event, str(assumed)) for event in str(events).split("; ") if event]
        return found


@dataclass(frozen=True)
class Outside:
    """An evaluation of `evaluate --act`: a policy of another learner in the place of that of a run.

    Attributes
    ----------
    name : str
        Name of its folder.
    run : Run
        The run that its episodes are those of.
    table : Table
        What it reached, class by class.
    """

    name: str
    run: Run
    table: Table


@dataclass
class Sources:
    """All inputs, and notes about those that are not in the report."""

    runs: list[Run] = field(default_factory=list)
    outside: list[Outside] = field(default_factory=list)
    tables: list[Table1] = field(default_factory=list)
    diagnosers: list[Diagnoser] = field(default_factory=list)
    traces: list[Trace] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def summary(self) -> str:
        """Return the number of inputs of each kind as text."""
        kinds: dict[str, Sequence[object]] = {
            "run": self.runs,
            "evaluation with --act": self.outside,
            "sweep of diagnosers": self.tables,
            "diagnoser": self.diagnosers,
            "trace": self.traces,
        }
        counts = [f"{len(found)} {_plural(kind, len(found))}" for kind, found in kinds.items() if found]
        return ", ".join(counts)


def _plural(kind: str, count: int) -> str:
    first, *rest = kind.split(" ")
    return " ".join([f"{first}s" if count > 1 else first, *rest])


def read(paths: Sequence[str | bytes | PathLike[str]]) -> Sources:
    """Read all paths, each only once.

    Raises
    ------
    ConfigError
        If there is no path, or one does not exist or is of an unknown kind.
    CheckpointError
        If a file cannot be read.
    """
    if not paths:
        raise ConfigError(f"there is nothing to report; {_EXPECTED}")
    for name in map(fsdecode, paths):
        try:
            name.encode()
        except UnicodeEncodeError as error:
            raise ConfigError(f"{name!a} has no name in UTF-8, which a report shows; rename it") from error
    sources = Sources()
    given = dict.fromkeys(Path(os.path.realpath(fsdecode(path))) for path in paths)
    for path in dict.fromkeys(cell for folder in given for cell in _cells(sources, folder)):
        _add(sources, path)
    return sources


def _cells(sources: Sources, path: Path) -> list[Path]:
    """Return the run folders of a sweep that have begun; the path itself if it is no sweep."""
    if not (path / "sweep.json").exists():
        return [path]
    cells = sorted(cell for cell in path.iterdir() if (cell / "config.toml").exists())
    if linked := [cell for cell in cells if cell.is_symlink()]:
        raise CheckpointError(f"{linked[0]} is a symbolic link, expected a folder")
    # A killed process can leave a file of metrics without a complete line.
    begun = [cell for cell in cells if read_lines(cell / "metrics.jsonl")]
    if not begun:
        raise ConfigError(f"{path} has no training that has finished an iteration; leave it out until it has")
    if waiting := [cell.name for cell in cells if cell not in begun]:
        sources.notes.append(
            f"Left out of the sweep {path.name}: {', '.join(waiting)}, which finished no iteration yet."
        )
    return begun


def _add(sources: Sources, path: Path) -> None:
    if path.is_file():
        _add_file(sources, path)
    elif not path.is_dir():
        raise ConfigError(f"{path} does not exist; {_EXPECTED}")
    elif (path / "table1.csv").exists():
        sources.tables.append(_table1(path / "table1.csv"))
    elif (path / "per_class.csv").exists() and path.parent.name == "eval":
        sources.outside.append(_outside(path))
    elif not (path / "config.toml").exists():
        raise ConfigError(f"{path} has no config.toml, sweep.json or table1.csv; {_EXPECTED}")
    elif _is_diagnoser(config := read_toml(path / "config.toml")):
        sources.diagnosers.append(_diagnoser(path, config))
    else:
        run = load_run(path)
        if not run.metrics:
            raise ConfigError(f"{path} has finished no iteration yet; leave it out until it has")
        sources.runs.append(run)


def _outside(path: Path) -> Outside:
    table = read_csv(path / "per_class.csv", ("name", "group", "forward_reward"))
    return Outside(path.name, load_run(path.parent.parent), table)


def _is_diagnoser(config: Mapping[str, Any]) -> bool:
    return "method" in config and "lstm" in config


def _add_file(sources: Sources, path: Path) -> None:
    try:
        header = read_text(path).partition("\n")[0].strip().split(",")
    except CheckpointError as error:
        raise ConfigError(f"{error}; {_EXPECTED}") from error
    if set(header) >= set(_TRACE):
        table = read_csv(path, _TRACE)
        if not len(table["step"]):
            raise CheckpointError(f"{path} is a trace without steps; write it again with `adapt --log`")
        for name in ("step", "forward_velocity", TRACKING.step_column):
            if name in table and table[name].dtype.kind not in "if":
                raise CheckpointError(
                    f"{path}: not every {name} is a number; write it again with `adapt --log`"
                )
        sources.traces.append(Trace(path, table))
    elif set(header) >= set(_TABLE1):
        sources.tables.append(_table1(path))
    else:
        raise ConfigError(f"{path} begins with {','.join(header)[:60]!r}; {_EXPECTED}")


def _table1(path: Path) -> Table1:
    table = read_csv(path, _TABLE1)
    if not len(table["robot"]):
        raise ConfigError(f"{path} has no finished cell yet; leave it out until it has")
    return Table1(path, str(table["robot"][0]), table)


def _diagnoser(path: Path, config: Mapping[str, Any]) -> Diagnoser:
    files = sorted((path / "eval").glob("*.confusion.csv"))
    tests = tuple(_test(file) for file in files)
    epochs = columns(read_lines(path / "metrics.jsonl"))
    if not epochs and not tests:
        raise ConfigError(f"{path} has finished no epoch yet; leave it out until it has")
    return Diagnoser(path, config, epochs, tests)


def _test(path: Path) -> DiagnoserTest:
    table = read_csv(path)
    # The corner of the table names rows and columns.
    corner, *classes = table
    names = tuple(classes)
    if tuple(table[corner].astype(str)) != names:
        raise CheckpointError(
            f"{path}: rows and columns have different classes; evaluate the diagnoser again"
        )
    data = path.name.removesuffix(".confusion.csv")
    summary_path = path.with_name(f"{data}.json")
    try:
        summary = json.loads(read_text(summary_path)) if summary_path.exists() else {}
    except (OSError, ValueError, RecursionError) as error:
        raise CheckpointError(f"{summary_path} cannot be read: {error}") from error
    try:
        counts = np.stack([table[name].astype(np.float64) for name in names], axis=1)
    except ValueError as error:
        raise CheckpointError(f"{path} holds no table of counts: {error}") from error
    if not isinstance(summary, dict):
        raise CheckpointError(f"{summary_path} holds {type(summary).__name__}, expected a JSON object")
    return DiagnoserTest(data, summary, names, counts)
