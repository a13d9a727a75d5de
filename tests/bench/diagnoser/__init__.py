"""``python -m tests.bench.diagnoser``: training the self-diagnose network, here and in PyTorch.

Every contender does the same work, `Task`, in a process of its own. They take turns, so the ratios hold on a
busy or throttled machine too; the absolute numbers are those of the moment.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dappo_batch.bench.measure import Missing, check, enter
from dappo_batch.machine import cores, describe
from dappo_batch.robots import load_robot

from ..limits import limited_to
from ..products import Products
from ..rounds import measure_rounds
from .data import collect
from .report import Cell, DiagnoserReport, cell_of
from .task import Task
from .trainers import Ours, Torch, TorchFolded, Trainer

__all__ = ["TRAINERS", "DiagnoserReport", "Trainer", "run"]

TRAINERS: tuple[type[Trainer], ...] = (Ours, Torch, TorchFolded)
"""Everything that may be measured; a new contender is a class like those here."""


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
        Rollouts that are trained on, each with a sample of every damage class.
    threads : sequence of int, optional
        Threads of each contender; one, and all cores, if left out.
    epochs : int
        Epochs of a sample, after one that is not counted.
    rounds : int
        Samples a contender.
    seconds : float
        Least length of a sample of the machine's rate of products, s.
    progress : callable, optional
        Told what happens, for example ``print``.

    Returns
    -------
    DiagnoserReport
        The numbers, and what could not be measured and why.

    Raises
    ------
    ConfigError
        If an argument is out of range or the robot unknown.
    SimulationError
        If the data cannot be made, or a contender fails after it has begun.
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
    """Return what all tasks have in common."""
    settings = asdict(task) | {"samples": task.samples}
    for name in ("threads", "minibatch", "data"):
        del settings[name]
    return settings


def _measure(
    task: Task, epochs: int, rounds: int, seconds: float, progress: Callable[[str], None]
) -> tuple[Cell, list[Missing]]:
    """Measure everybody `rounds` times at one task."""

    def tell(what: str) -> None:
        progress(f"{task.threads} threads, minibatch {task.minibatch}, {what}")

    entered = enter({kind.key: kind for kind in TRAINERS}, task, progress)
    with (
        limited_to(task.threads),
        entered as (entrants, missing),
        closing(Products(task.threads)) as products,
    ):
        trainers = [*entrants.values()]
        found = measure_rounds(products.measure, trainers, epochs, rounds, seconds, tell)
    return cell_of(task, found, trainers, products.note), missing
