"""``python -m tests.bench.training``: env steps per second of complete PPO training beside other libraries.

Every contender does the same work, `Task`, in a process of its own. They take turns, so the ratios hold on a
busy or throttled machine too; the absolute numbers are those of the moment.
"""

from __future__ import annotations

from collections.abc import Callable
from contextlib import closing
from dataclasses import asdict
from typing import Any

from dappo_batch.bench.measure import Spread, check, enter
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
    Trainer,
)

__all__ = ["TRAINERS", "Trainer", "TrainingReport", "run"]

TRAINERS: tuple[type[Trainer], ...] = (Lanes, Mujoco, AsConfigured, StableBaselines, EnvPoolTorch)
"""Everything that may be measured; a new contender is a class like those here."""


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
    """Measure the training of this package beside that of every other library that is installed.

    Parameters
    ----------
    num_envs, horizon : int
        Environments N, and env steps T of each in one iteration.
    threads : int, optional
        Threads of each contender; all cores if left out.
    iterations : int
        Iterations of a sample.
    rounds : int
        Samples a contender.
    seconds : float
        Least length of a sample of the machine's rates, s.
    progress : callable, optional
        Told what happens, for example ``print``.

    Returns
    -------
    TrainingReport
        The numbers, and what could not be measured and why.

    Raises
    ------
    ConfigError
        If an argument is out of range.
    SimulationError
        If a contender fails after it has begun.
    """
    task = Task(cores() if threads is None else threads, num_envs, horizon)
    counts = {"envs": num_envs, "horizon": horizon, "threads": task.threads}
    counts |= {"iterations": iterations, "rounds": rounds}
    check({name: [value] for name, value in counts.items()}, seconds)
    described = describe()
    entered = enter({kind.key: kind for kind in TRAINERS}, task, progress)
    with limited_to(task.threads), entered as (entrants, missing), closing(Machine(task)) as machine:
        trainers = [*entrants.values()]
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
