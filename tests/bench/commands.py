"""Commands of ``dappo-batch`` in separate processes, and the contents of their run folders."""

from __future__ import annotations

import json
import os
import subprocess
import tempfile
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..processes import DAPPO_BATCH
from .limits import thread_limits

__all__ = [
    "TrainingFailed",
    "TrainingRun",
    "command_line",
    "read_metrics",
    "train",
]

_UNREADABLE = "the run folder cannot be read"


class TrainingFailed(Exception):
    """``dappo-batch train`` failed; the text contains the reason."""


@dataclass(frozen=True)
class TrainingRun:
    """The contents of a run folder.

    Attributes
    ----------
    config : dict
        The complete configuration, ``config.toml``.
    metrics : tuple of dict
        One for each iteration, the lines of ``metrics.jsonl``.
    learner : dict
        ``learner.toml`` of the newest checkpoint: shapes, and the state of the learner.
    """

    config: dict[str, Any]
    metrics: tuple[dict[str, Any], ...]
    learner: dict[str, Any]

    @classmethod
    def read(cls, folder: Path) -> TrainingRun:
        """Read the run in `folder`.

        Raises
        ------
        TrainingFailed
            If a file is missing or invalid, or if there was no iteration.
        """
        try:
            config = tomllib.loads((folder / "config.toml").read_text(encoding="utf-8"))
            metrics = read_metrics(folder)
            newest = max((folder / "checkpoints").iterdir())
            learner = tomllib.loads((newest / "learner.toml").read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise TrainingFailed(f"{_UNREADABLE}: {type(error).__name__}: {error}") from error
        return cls(config, metrics, learner)


def read_metrics(folder: Path) -> tuple[dict[str, Any], ...]:
    """Read ``metrics.jsonl`` of a training of a policy or a diagnoser.

    Raises
    ------
    TrainingFailed
        If it is missing, empty or invalid.
    """
    try:
        lines = (folder / "metrics.jsonl").read_text(encoding="utf-8").splitlines()
        metrics = tuple(json.loads(line) for line in lines)
    except (OSError, ValueError) as error:
        raise TrainingFailed(f"{_UNREADABLE}: {type(error).__name__}: {error}") from error
    if not metrics:
        raise TrainingFailed("the run has no metrics: training ended before its first line")
    return metrics


def train(arguments: Sequence[str], threads: int, timeout: float = 600.0) -> TrainingRun:
    """Run ``dappo-batch train`` in a separate process and a temporary folder, and read its run folder.

    Parameters
    ----------
    arguments : sequence of str
        Arguments of ``train``, without ``--run`` and ``--json``; the last may be values of ``--set``.
    threads : int
        Threads of Python's linear algebra; those of the training are an argument of ``train``.
    timeout : float
        Maximum time, s.

    Raises
    ------
    TrainingFailed
        If it fails, takes too long, or its run folder cannot be read.
    """
    with tempfile.TemporaryDirectory(prefix="dappo-batch-bench-") as folder:
        run = Path(folder) / "run"
        command_line(["train", "--run", str(run), "--json", *arguments], threads, timeout)
        return TrainingRun.read(run)


def command_line(arguments: Sequence[str], threads: int, timeout: float = 600.0) -> str:
    """Run ``dappo-batch`` in a separate process and return its standard output.

    Raises
    ------
    TrainingFailed
        If it fails or takes too long.
    """
    name = f"`dappo-batch {arguments[0]}`"
    try:
        done = subprocess.run(
            [*DAPPO_BATCH, *arguments],
            env={**os.environ, **thread_limits(threads)},
            capture_output=True,
            text=True,
            check=False,
            timeout=timeout,
        )
    except subprocess.TimeoutExpired:
        raise TrainingFailed(f"{name} took longer than {timeout:.0f} s") from None
    if done.returncode != 0:
        output = (done.stderr.strip() or done.stdout.strip() or "no output")[-500:]
        raise TrainingFailed(f"{name} ended with exit code {done.returncode}: {output}")
    return done.stdout
