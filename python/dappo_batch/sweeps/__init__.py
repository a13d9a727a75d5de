"""Sweeps: a grid of trainings over any executor, which can be resumed."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor, Future, as_completed
from pathlib import Path
from typing import Any

from dappo_batch._checks import folder as _folder
from dappo_batch._checks import mapping, shown
from dappo_batch._core import CheckpointError, ConfigError, check_settings, write_file
from dappo_batch.commands import Folder
from dappo_batch.runs.tables import read_text
from dappo_batch.sweeps.cell import Cell, cells_of, options_of
from dappo_batch.sweeps.worker import processes, train_cell

__all__ = ["Cell", "sweep"]


def sweep(
    base: Mapping[str, Any],
    grid: Mapping[str, Sequence[Any]],
    out: Folder,
    *,
    executor: Executor | None = None,
    callback: Callable[[Cell], object] | None = None,
) -> list[Cell]:
    """Train every combination of the grid, each in its own folder.

    A call with the same folder resumes the sweep: completed cells are kept, and a cell that was stopped or
    killed continues from its newest checkpoint. The grid may be larger; `base` must be the same.

    Parameters
    ----------
    base
        Options of `train`, or settings such as ``"ppo.gamma"``, of all cells.
    grid
        Values by option or setting.
    out
        Folder of the sweep.
    executor
        Any executor whose workers have access to the folder. By default one process at a time on this
        machine, with all cores.
    callback
        Called with each cell when it ends.

    Returns
    -------
    list of Cell
        All cells, in the order of the grid. A failed cell contains its error and does not stop the others.

    Raises
    ------
    ConfigError
        If the grid is empty, an argument is of the wrong type, or the folder contains a sweep with another
        base or cannot be written.
    CheckpointError
        If its ``sweep.json`` cannot be read.
    """
    folder = _folder(out, "out").absolute()
    if executor is not None and not isinstance(executor, Executor):
        raise ConfigError(f"executor must be a concurrent.futures.Executor, got {shown(executor)}")
    if callback is not None and not callable(callback):
        raise ConfigError(f"callback must be a function, got {shown(callback)}")
    cells = list(cells_of(grid, folder))
    # An option that is None is left out, as in `train`.
    base = {key: value for key, value in mapping(base, "base").items() if value is not None}
    # Checks types of settings before the first cell.
    check_settings({key: value for key, value in base.items() if key != "set"}, "base")
    check_settings(base.get("set") or {}, "set")
    _claim(folder, base)
    if executor is None:
        with processes(1) as pool:
            return _run_all(cells, base, pool, callback)
    return _run_all(cells, base, executor, callback)


def _claim(folder: Path, base: Mapping[str, Any]) -> None:
    """Write `base` to ``sweep.json``, or check that it is the same as in an earlier call."""
    path = folder / "sweep.json"
    wanted = json.loads(json.dumps({"base": dict(base)}, default=str))
    if not path.exists():
        try:
            write_file(path, (json.dumps(wanted, indent=2) + "\n").encode())
        except OSError as error:
            raise ConfigError(f"{path} cannot be written: {error}") from error
        return
    try:
        known = json.loads(read_text(path))
    except (ValueError, RecursionError) as error:
        raise CheckpointError(f"{path} cannot be read: {error}") from error
    if known != wanted:
        other = known.get("base") if isinstance(known, dict) else known
        raise ConfigError(
            f"{folder} contains a sweep with another base: {json.dumps(other)}; choose another folder"
        )


def _run_all(
    cells: Sequence[Cell],
    base: Mapping[str, Any],
    executor: Executor,
    callback: Callable[[Cell], object] | None,
) -> list[Cell]:
    futures = {
        executor.submit(train_cell, str(cell.path), options_of({**base, **cell.values})): cell
        for cell in cells
    }
    ended: dict[Path, Cell] = {}
    try:
        for future in as_completed(futures):
            cell = _ended(futures[future], future)
            ended[cell.path] = cell
            if callback is not None:
                callback(cell)
    finally:
        for future in futures:
            future.cancel()
    return [ended[cell.path] for cell in cells]


def _ended(cell: Cell, future: Future[None]) -> Cell:
    error = future.exception()
    if isinstance(error, KeyboardInterrupt):
        raise error
    return cell if error is None else Cell(cell.values, cell.path, f"{type(error).__name__}: {error}")
