"""``dappo-batch bench``: env steps per second and processor time beside other simulators.

Everything runs in one process, interleaved, from the same states and with the same kind of actions, so the
ratios hold on a busy or throttled machine too; the absolute numbers are those of the moment.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
from collections.abc import Callable, Sequence

import mujoco
import numpy as np

from dappo_batch._core import ConfigError, SimulationError
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
    Unavailable,
)
from dappo_batch.bench.learner import learner_share
from dappo_batch.bench.machine import cores, cpu_name, load_average
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
    machine = {
        "cpu": cpu_name(),
        "cores": cores(),
        "load_average": load_average(),
        "mujoco": mujoco.__version__,
        "numpy": np.__version__,
        "python": platform.python_version(),
    }
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
    """Make every contender that can run here, and say why the others cannot."""
    contenders: list[Contender] = []
    missing: list[Missing] = []
    for kind in CONTENDERS:
        progress(f"making {kind.key}")
        try:
            contenders.append(kind(workload))
        except Unavailable as reason:
            missing.append(Missing(kind.key, str(reason), reason.install))
    return contenders, missing


def main(argv: Sequence[str]) -> int:
    """Run ``dappo-batch bench`` and return its exit code.

    Parameters
    ----------
    argv : sequence of str
        The arguments behind ``bench``.
    """
    arguments = _parser().parse_args(argv)
    if arguments.list:
        _print_list(arguments.robot, arguments.json)
        return 0
    report = run(
        arguments.robot,
        num_envs=arguments.envs,
        threads=arguments.threads,
        seconds=arguments.seconds,
        rounds=arguments.rounds,
        learner=not arguments.no_learner,
        progress=_say,
    )
    print(json.dumps(report.as_dict(), indent=2) if arguments.json else report.text())
    return 0


def _say(what: str) -> None:
    """Show progress where it does not get between the lines of a file or a pipe."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{what} …", end="", file=sys.stderr, flush=True)


def _print_list(robot: str, as_json: bool) -> None:
    contenders, missing = _enter(Workload.of(robot, num_envs=1, threads=1), lambda _: None)
    for contender in contenders:
        contender.close()
    absent = {one.key: one for one in missing}
    rows = [
        {
            "key": kind.key,
            "about": kind.about,
            "available": kind.key not in absent,
            "reason": absent[kind.key].reason if kind.key in absent else "",
            "install": absent[kind.key].install if kind.key in absent else "",
        }
        for kind in CONTENDERS
    ]
    if as_json:
        print(json.dumps(rows, indent=2))
        return
    for row in rows:
        cure = f"; to install it: {row['install']}" if row["install"] else ""
        remark = "" if row["available"] else f" [{row['reason']}{cure}]"
        print(f"{row['key']:20} {row['about']}{remark}")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="dappo-batch bench",
        description="Env steps per second and processor time of this package beside other simulators, "
        "interleaved in one process.",
        formatter_class=argparse.ArgumentDefaultsHelpFormatter,
    )
    parser.add_argument("--robot", default="ant", metavar="NAME|FILE", help="robot to simulate")
    parser.add_argument("--envs", type=int, default=4096, metavar="N", help="environments")
    parser.add_argument("--threads", type=int, default=cores(), metavar="N", help="threads of each contender")
    parser.add_argument("--seconds", type=float, default=2.0, metavar="S", help="least length of a sample")
    parser.add_argument("--rounds", type=int, default=5, metavar="N", help="samples a contender, interleaved")
    parser.add_argument("--no-learner", action="store_true", help="leave out the training run")
    parser.add_argument("--list", action="store_true", help="list the contenders and what they need")
    parser.add_argument("--json", action="store_true", help="print JSON")
    return parser
