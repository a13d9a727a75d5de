"""The work of a sweep's worker processes."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing import get_context
from pathlib import Path
from typing import Any, cast

from dappo_batch._core import ConfigError
from dappo_batch.commands import TrainingOptions, resume, train
from dappo_batch.runs import Run, load_run

__all__ = ["processes", "train_cell"]


def processes(jobs: int) -> ProcessPoolExecutor:
    """Return an executor with `jobs` processes on this machine."""
    # A forked process would inherit locks without their threads.
    return ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))


def train_cell(path: str, options: dict[str, Any]) -> None:
    """Train or resume a cell, unless it is complete, while no other process does.

    A cluster that lost the connection to a worker starts another one while the first may still run.
    """
    folder = Path(path)
    with _locked(folder.with_name(f".{folder.name}.lock")):
        if not (folder / "config.toml").exists():
            train(folder, **cast("TrainingOptions", options))
        elif not _is_done(load_run(folder)):
            resume(folder, threads=options.get("threads"))


@contextmanager
def _locked(path: Path) -> Iterator[None]:
    """Wait for a file lock, which the system releases when its process ends."""
    try:
        # Links and pipes are not opened, and files are not truncated.
        lock = os.open(path, os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK, 0o666)
    except OSError as error:
        raise ConfigError(f"{path} cannot be locked: {error}") from error
    try:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
    finally:
        os.close(lock)


def _is_done(run: Run) -> bool:
    steps = run.metrics.get("env_steps")
    is_trained = steps is not None and len(steps) > 0 and bool(steps[-1] >= run.config["total_steps"])
    return is_trained and "true" in run.per_class
