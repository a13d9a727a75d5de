"""A run folder as NumPy arrays."""

from __future__ import annotations

import json
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from dappo_batch._checks import folder as _folder
from dappo_batch._core import CheckpointError, ConfigError
from dappo_batch.results import Meta
from dappo_batch.runs.tables import Table, columns, read_csv, read_text

__all__ = ["Run", "load_run"]

_PER_CLASS = ("class", "name", "group", "forward_reward")
_GROUPS = ("group", "classes", "forward_reward")
_ADAPTATION = ("class", "name", "adapted", "oracle", "no_adaptation")
_EARLIER_ADAPTATION = {
    "ended_before": "ended_before_onset",
    "right_at_first": "correct_first",
    "right_at_last": "correct_last",
    "examinations": "diagnosis_windows",
    "unadapted": "no_adaptation",
}
"""Columns as earlier versions named them."""


@dataclass(frozen=True)
class Run:
    """The files of a run folder; tables are NumPy arrays of equal length, by column.

    Attributes
    ----------
    path : Path
        The folder.
    config : mapping
        The resolved configuration, ``config.toml``.
    meta : Meta
        Metadata, ``meta.json``; without entries if that is missing.
    metrics : Table
        One entry for each iteration, ``metrics.jsonl``; means over no episodes are NaN.
    per_class, groups : mapping from str to Table
        The evaluations by encoding: ``true``, ``zero``, ``wrong`` or ``random``. Those that do not exist are
        missing.
    adaptation : Table or None
        Results of `adapt`, class by class, ``eval/adapt.csv``.

    Notes
    -----
    Columns and units are those of the files. Files of older versions lack some of them.
    """

    path: Path
    config: Mapping[str, Any]
    meta: Meta
    metrics: Table
    per_class: Mapping[str, Table]
    groups: Mapping[str, Table]
    adaptation: Table | None

    @property
    def robot(self) -> str:
        """Name of the robot, or the path of its TOML."""
        return str(self.config["robot"])

    @property
    def seed(self) -> int:
        """Seed of the training."""
        return int(self.config["seed"])

    @property
    def observes_damage(self) -> bool:
        """Whether the policy observes the damage code (DA-PPO) or not (PPO-Unaware)."""
        return bool(self.config["env"]["observe_damage"])


def load_run(path: str | bytes | PathLike[str]) -> Run:
    """Read a run folder.

    Parameters
    ----------
    path : path-like
        Folder of `train` or ``dappo-batch train``. The training may still be running.

    Raises
    ------
    ConfigError
        If the folder does not exist or is not a run folder.
    CheckpointError
        If a file in it cannot be read.

    Examples
    --------
    >>> run = dappo_batch.load_run("runs/first")
    >>> run.metrics["forward_reward"][-1], run.per_class["true"]["forward_reward"].mean()
    """
    folder = _folder(path, "path")
    config = _config(folder)
    return Run(
        path=folder,
        config=config,
        meta=_meta(folder / "meta.json"),
        metrics=columns(read_lines(folder / "metrics.jsonl")),
        per_class=_evaluations(folder, "per_class", _PER_CLASS),
        groups=_evaluations(folder, "groups", _GROUPS),
        adaptation=_optional(folder / "eval" / "adapt.csv", _ADAPTATION, _EARLIER_ADAPTATION),
    )


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file; errors are `CheckpointError`."""
    try:
        return tomllib.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise CheckpointError(f"{path} cannot be read: {error}") from error


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Read one JSON object from each line, except an incomplete last line."""
    if not path.exists():
        return []
    rows = []
    lines = read_text(path, errors="replace").split("\n")
    for number, line in enumerate(lines[:-1], start=1):
        try:
            row = json.loads(line)
        except (ValueError, RecursionError) as error:
            raise CheckpointError(f"{path}, line {number}: {error}") from error
        if not isinstance(row, dict):
            raise CheckpointError(f"{path}, line {number} is {line[:40]!r}, expected a JSON object")
        rows.append(row)
    return rows


def _config(folder: Path) -> dict[str, Any]:
    if not folder.is_dir():
        raise ConfigError(f"{folder} is not a folder; expected a run folder of `dappo-batch train`")
    path = folder / "config.toml"
    if not path.exists():
        raise ConfigError(f"{folder} is not a run folder: it has no config.toml")
    config = read_toml(path)
    lacking = [key for key in ("robot", "seed", "total_steps", "env", "ppo") if key not in config]
    if not lacking and not (isinstance(config["env"], dict) and "observe_damage" in config["env"]):
        lacking = ["env.observe_damage"]
    if lacking:
        raise ConfigError(f"{folder} is not a run folder: its config.toml has no {', '.join(lacking)}")
    return config


def _meta(path: Path) -> Meta:
    if not path.exists():
        return Meta()
    try:
        meta = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise CheckpointError(f"{path} cannot be read: {error}") from error
    if not isinstance(meta, dict):
        raise CheckpointError(f"{path} holds {type(meta).__name__}, expected a JSON object")
    try:
        return Meta.from_dict(meta)
    except ConfigError as error:
        raise CheckpointError(f"{path} cannot be read: {error}") from error


def _evaluations(folder: Path, name: str, required: tuple[str, ...]) -> dict[str, Table]:
    """Read ``NAME.csv``, the encoding ``true``, and ``NAME.ENCODING.csv``."""
    found = {}
    for encoding in ("true", "zero", "wrong", "random"):
        path = folder / "eval" / (f"{name}.csv" if encoding == "true" else f"{name}.{encoding}.csv")
        table = _optional(path, required)
        if table is not None:
            if not len(table[required[0]]):
                raise CheckpointError(f"{path} has no rows; run dappo-batch evaluate again")
            found[encoding] = table
    return found


def _optional(
    path: Path, required: tuple[str, ...], earlier: Mapping[str, str] | None = None
) -> Table | None:
    return read_csv(path, required, earlier) if path.exists() else None
