"""``dappo-batch bench``: env steps per second and processor time beside other simulators.

Everything runs in one process, interleaved, from the same states and with the same kind of actions, so the
ratios hold on a busy or throttled machine too; the absolute numbers are those of the moment.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Sequence
from functools import partial

from dappo_batch._core import ConfigError, SimulationError
from dappo_batch.bench import diagnoser, training
from dappo_batch.bench.arguments import options, parse
from dappo_batch.bench.contenders import (
    Contender,
    LanesF32,
    LanesF32Copy,
    LanesF32Damaged,
    LanesF64,
    MujocoBackend,
    MujocoBatch,
    MujocoRollout,
    RawStep,
)
from dappo_batch.bench.entry import Entrant, absent, enter
from dappo_batch.bench.learner import learner_share
from dappo_batch.bench.machine import cores, describe
from dappo_batch.bench.measure import measure_rounds, peak_memory_mb
from dappo_batch.bench.peers import EnvPoolAnt, GymnasiumAnt
from dappo_batch.bench.report import Missing, Report, results
from dappo_batch.bench.workload import Workload

__all__ = ["CONTENDERS", "main", "run"]

CONTENDERS: tuple[type[Contender], ...] = (
    RawStep,
    LanesF32,
    LanesF32Copy,
    LanesF32Damaged,
    LanesF64,
    MujocoBackend,
    MujocoBatch,
    MujocoRollout,
    EnvPoolAnt,
    GymnasiumAnt,
)
"""Everything that may be measured; a new contender is a class like those here."""


def run(
    robot: str = "ant",
    *,
    num_envs: int = 4096,
    threads: int | None = None,
    seconds: float = 2.0,
    rounds: int = 5,
    learner: bool = True,
    progress: Callable[[str], None] = lambda _: None,
) -> Report:
    """Measure this package beside every other way to step a robot that is installed.

    Parameters
    ----------
    robot : str
        Name of a robot or path of a robot TOML.
    num_envs : int
        Number of environments N.
    threads : int, optional
        Threads of each contender; all cores if left out.
    seconds : float
        Least length of a sample, s.
    rounds : int
        Samples a contender.
    learner : bool
        Whether to train for a few iterations, too.
    progress : callable, optional
        Told what happens, for example ``print``.

    Returns
    -------
    Report
        The numbers, and what could not be measured and why.

    Raises
    ------
    ConfigError
        If an argument is out of range or the robot unknown.
    """
    threads = cores() if threads is None else threads
    for name, value in (("envs", num_envs), ("threads", threads), ("rounds", rounds)):
        if value < 1:
            raise ConfigError(f"{name} must be at least 1, got {value}")
    if not 0.0 < seconds < float("inf"):
        raise ConfigError(f"seconds must be above 0, got {seconds}")
    machine = describe()
    workload = Workload.of(robot, num_envs, threads)
    contenders, missing = _enter(workload, progress)
    try:
        samples = measure_rounds(contenders, seconds, rounds, progress)
    finally:
        for contender in contenders:
            contender.close()
    described = {one.key: (one.about, one.note, one.num_envs) for one in contenders}
    progress("measuring memory")
    memory_mb, memory_error = None, ""
    try:
        memory_mb = peak_memory_mb(robot, num_envs, threads)
    except SimulationError as error:
        memory_error = str(error)
    if learner:
        progress("training for a few iterations")
    return Report(
        machine=machine,
        settings={
            "robot": workload.robot.name,
            "num_envs": num_envs,
            "threads": threads,
            "seconds": seconds,
            "rounds": rounds,
        },
        results=results(samples, described),
        missing=tuple(missing),
        memory_mb=memory_mb,
        memory_error=memory_error,
        learner=learner_share(robot, threads) if learner else None,
    )


def _enter(workload: Workload, progress: Callable[[str], None]) -> tuple[list[Contender], list[Missing]]:
    return enter({kind.key: partial(kind, workload) for kind in CONTENDERS}, progress)


def main(argv: Sequence[str]) -> int:
    """Run ``dappo-batch bench`` and return its exit code.

    Parameters
    ----------
    argv : sequence of str
        The arguments behind ``bench``.
    """
    arguments = parse(argv)
    if arguments.list:
        _print_list(arguments)
        return 0
    given = options(arguments)
    report: Report | training.TrainingReport | diagnoser.DiagnoserReport
    if arguments.training:
        report = training.run(**given, progress=_say)
    elif arguments.diagnoser:
        report = diagnoser.run(**given, progress=_say)
    else:
        report = run(**given, progress=_say)
    print(json.dumps(report.as_dict(), indent=2) if arguments.json else report.text())
    return 0


def _say(what: str) -> None:
    """Show progress where it does not get between the lines of a file or a pipe."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{what} …", end="", file=sys.stderr, flush=True)


def _print_list(arguments: argparse.Namespace) -> None:
    kinds: Sequence[type[Contender | Entrant]]
    if arguments.training or arguments.diagnoser:
        entrants: Sequence[type[Entrant]] = training.TRAINERS if arguments.training else diagnoser.TRAINERS
        kinds, missing = entrants, absent(entrants)
    else:
        kinds = CONTENDERS
        workload = Workload.of(arguments.robot or "ant", num_envs=1, threads=1)
        contenders, missing = _enter(workload, lambda _: None)
        for contender in contenders:
            contender.close()
    reasons = {one.key: one for one in missing}
    rows = [
        {
            "key": kind.key,
            "about": kind.about,
            "available": kind.key not in reasons,
            "reason": reasons[kind.key].reason if kind.key in reasons else "",
            "install": reasons[kind.key].install if kind.key in reasons else "",
        }
        for kind in kinds
    ]
    if arguments.json:
        print(json.dumps(rows, indent=2))
        return
    for row in rows:
        cure = f"; to install it: {row['install']}" if row["install"] else ""
        remark = "" if row["available"] else f" [{row['reason']}{cure}]"
        print(f"{row['key']:25} {row['about']}{remark}")
