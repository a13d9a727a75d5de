"""``python -m tests.bench.training``: env steps per second of PPO training, compared with other libraries.

Every trainer does the same work, `Task`, in a separate process, and measurements are interleaved. The ratios
are therefore valid on a busy or throttled machine too; the absolute numbers depend on its current load.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from typing import Any

from dappo_batch.bench.measure import Spread, check, open_all
from dappo_batch.machine import cores, describe

from ..limits import limited_to
from ..rounds import measure_rounds
from .bound import Machine
from .report import TrainingReport, results
from .task import Task
from .trainers import (
    AsConfigured,
    EnvPoolTorch,
    Lanes,
    Mujoco,
    StableBaselines,
    Symmetric,
    Trainer,
)

__all__ = ["TRAINERS", "Trainer", "TrainingReport", "run"]

TRAINERS: tuple[type[Trainer], ...] = (Lanes, Symmetric, Mujoco, AsConfigured, StableBaselines, EnvPoolTorch)
"""All trainers; add new ones here."""


def run(
    *,
    num_envs: int = 16,
    horizon: int = 512,
    threads: int | None = None,
    iterations: int = 3,
    rounds: int = 5,
    seconds: float = 2.0,
    progress: Callable[[str], None] = lambda _: None,
) -> TrainingReport:
    """Measure the training of this package and of the other libraries that are installed.

    Parameters
    ----------
    num_envs, horizon : int
        Environments N, and env steps T of each in one iteration.
    threads : int, optional
        Threads of each trainer; by default the number of cores.
    iterations : int
        Iterations of a sample.
    rounds : int
        Samples of each trainer.
    seconds : float
        Minimum duration of a sample of the machine's rates, s.
    progress : callable, optional
        Called with a text before each measurement, for example ``print``.

    Returns
    -------
    TrainingReport
        The results, and the trainers that were not measured, with reasons.

    Raises
    ------
    ConfigError
        If an argument is out of range.
    SimulationError
        If a trainer fails after its start.
    """
    task = Task(cores() if threads is None else threads, num_envs, horizon)
    counts = {"envs": num_envs, "horizon": horizon, "threads": task.threads}
    counts |= {"iterations": iterations, "rounds": rounds}
    check({name: [value] for name, value in counts.items()}, seconds)
    described = describe()
    opened = open_all({kind.key: kind for kind in TRAINERS}, task, progress)
    with limited_to(task.threads), opened as (entries, missing), closing(Machine(task)) as machine:
        trainers = [*entries.values()]
        measured = measure_rounds(machine.measure, trainers, iterations, rounds, seconds, progress)
    return TrainingReport(
        machine=described,
        settings=_settings(task) | {"iterations": iterations, "rounds": rounds, "seconds": seconds},
        results=results(measured, trainers),
        missing=tuple(missing),
        sgemm=Spread.of([one.machine.sgemm for one in measured]),
        sgemm_note=machine.note,
        physics={
            key: Spread.of([one.machine.physics[key] for one in measured])
            for key in measured[0].machine.physics
        },
    )


def _settings(task: Task) -> dict[str, Any]:
    settings = asdict(task) | {"minibatch": task.minibatch}
    del settings["minibatch_rows"]
    return settings
