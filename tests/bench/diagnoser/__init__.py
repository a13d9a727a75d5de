"""``python -m tests.bench.diagnoser``: training the diagnoser, compared with PyTorch.

Every trainer does the same work, `Task`, in a separate process, and measurements are interleaved. The ratios
are therefore valid on a busy or throttled machine too; the absolute numbers depend on its current load.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dappo_batch.bench.measure import Missing, check, open_all
from dappo_batch.machine import cores, describe
from dappo_batch.robots import load_robot

from ..limits import limited_to
from ..matmul import SgemmBenchmark
from ..rounds import measure_rounds
from .data import collect
from .report import Cell, DiagnoserReport, cell_of
from .task import Task
from .trainers import Ours, Torch, TorchFolded, Trainer

__all__ = ["TRAINERS", "DiagnoserReport", "Trainer", "run"]

TRAINERS: tuple[type[Trainer], ...] = (Ours, Torch, TorchFolded)
"""All trainers; add new ones here."""


def run(
    robot: str = "ant",
    *,
    minibatches: Sequence[int] = (64, 256),
    timesteps: int = 50,
    rollouts: int = 100,
    threads: Sequence[int] | None = None,
    epochs: int = 2,
    rounds: int = 5,
    seconds: float = 2.0,
    progress: Callable[[str], None] = lambda _: None,
) -> DiagnoserReport:
    """Measure how fast the diagnoser trains, with every number of threads and every size of minibatch.

    Parameters
    ----------
    robot : str
        Name of a robot or path of a robot TOML.
    minibatches : sequence of int
        Samples of a minibatch B.
    timesteps : int
        Steps of a window, T.
    rollouts : int
        Rollouts of the training data, each with a sample of every damage class.
    threads : sequence of int, optional
        Threads of each trainer; by default one, and the number of cores.
    epochs : int
        Epochs of a sample, after one that is not counted.
    rounds : int
        Samples of each trainer.
    seconds : float
        Minimum duration of a sample of the machine's rate of matrix multiplications, s.
    progress : callable, optional
        Called with a text before each measurement, for example ``print``.

    Returns
    -------
    DiagnoserReport
        The results, and the trainers that were not measured, with reasons.

    Raises
    ------
    ConfigError
        If an argument is out of range or the robot unknown.
    SimulationError
        If the data cannot be collected, or a trainer fails after its start.
    """
    threads = sorted({1, cores()}) if threads is None else threads
    counts = {"timesteps": [timesteps], "rollouts": [rollouts], "epochs": [epochs], "rounds": [rounds]}
    check({"minibatch": minibatches, "threads": threads, **counts}, seconds)
    name, described = load_robot(robot).name, describe()
    with tempfile.TemporaryDirectory(prefix="dappo-batch-bench-") as folder:
        progress("collecting the data")
        data = collect(robot, rollouts + 1, timesteps, max(threads), Path(folder))
        sizes = (str(data.folder), rollouts, data.classes, timesteps, data.inputs)
        tasks = [Task(count, minibatch, *sizes) for count in threads for minibatch in minibatches]
        measured = [_measure(task, epochs, rounds, seconds, progress) for task in tasks]
    return DiagnoserReport(
        machine=described,
        settings={"robot": name}
        | _settings(tasks[0])
        | {"epochs": epochs, "rounds": rounds, "seconds": seconds},
        cells=tuple(cell for cell, _ in measured),
        missing=tuple(dict.fromkeys(one for _, missing in measured for one in missing)),
    )


def _settings(task: Task) -> dict[str, Any]:
    """Return the settings that all tasks share."""
    settings = asdict(task) | {"samples": task.samples}
    for name in ("threads", "minibatch", "data"):
        del settings[name]
    return settings


def _measure(
    task: Task, epochs: int, rounds: int, seconds: float, progress: Callable[[str], None]
) -> tuple[Cell, list[Missing]]:
    """Measure every trainer `rounds` times at one task."""

    def progress_of_task(what: str) -> None:
        progress(f"{task.threads} threads, minibatch {task.minibatch}, {what}")

    opened = open_all({kind.key: kind for kind in TRAINERS}, task, progress)
    with (
        limited_to(task.threads),
        opened as (entries, missing),
        closing(SgemmBenchmark(task.threads)) as sgemm,
    ):
        trainers = [*entries.values()]
        found = measure_rounds(sgemm.measure, trainers, epochs, rounds, seconds, progress_of_task)
    return cell_of(task, found, trainers, sgemm.note), missing
