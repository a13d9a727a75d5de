"""``dappo-batch bench``: env steps per second and processor time, compared with other simulators.

All simulators run interleaved in one process, with the same distributions of states and actions. The ratios
are therefore valid on a busy or throttled machine too; the absolute numbers depend on its current load.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from json import dumps
from typing import Any

from dappo_batch import machine
from dappo_batch.bench import measure
from dappo_batch.bench.measure import Missing, Sample, Spread, align, check, measure_rounds, open_all
from dappo_batch.bench.simulators import SIMULATORS, Simulator, Workload
from dappo_batch.robots import load_robot

__all__ = ["BASE", "Missing", "Report", "Result", "command", "run"]

BASE = "mj_step"
"""Name of the simulator with which all others are compared."""


@dataclass(frozen=True)
class Result:
    """The results of one simulator.

    ``rate`` is in env steps per second of elapsed time, ``ratio`` the rate divided by that of `BASE` in the
    same round, ``cpu_us`` the processor time of an env step in µs.
    """

    key: str
    note: str
    num_envs: int
    rate: Spread
    cpu_us: Spread
    ratio: Spread


@dataclass(frozen=True)
class Report:
    """The machine, the settings, the results, and the simulators that were not measured."""

    machine: dict[str, Any]
    settings: dict[str, Any]
    results: tuple[Result, ...]
    missing: tuple[Missing, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the report as a dictionary that can be written as JSON."""
        return asdict(self) | {"base": BASE}

    def text(self) -> str:
        """Return the report as text."""
        one = self.settings
        head = ("", "env steps/s", "CPU µs a step", f"speed / {BASE}", "envs")
        rows = [
            (
                result.key,
                f"{result.rate.median:,.0f}",
                f"{result.cpu_us.median:.1f}",
                result.ratio.text(".2f"),
                str(result.num_envs),
            )
            for result in self.results
        ]
        return "\n".join(
            [
                machine.text(self.machine),
                f"robot {one['robot']}: {one['threads']} threads, {one['rounds']} rounds of"
                f" {one['seconds']:g} s each, medians (lowest to highest)",
                "",
                align([head, *rows]),
                "",
                *(f"{result.key}: {result.note}" for result in self.results if result.note),
                *map(str, self.missing),
            ]
        ).rstrip()


def run(
    robot: str = "ant",
    *,
    num_envs: int = 1024,
    threads: int | None = None,
    seconds: float = 2.0,
    rounds: int = 5,
    progress: Callable[[str], None] = lambda _: None,
) -> Report:
    """Measure this package and the other simulators that are installed.

    Parameters
    ----------
    robot : str
        Name of a robot or path of a robot TOML.
    num_envs : int
        Number of environments N.
    threads : int, optional
        Threads of each simulator; by default the number of cores.
    seconds : float
        Minimum duration of a sample, s.
    rounds : int
        Samples of each simulator.
    progress : callable
        Called with a text before each measurement, for example ``print``.

    Raises
    ------
    ConfigError
        If an argument is out of range or the robot unknown.
    """
    threads = machine.cores() if threads is None else threads
    check({"num_envs": [num_envs], "threads": [threads], "rounds": [rounds]}, seconds)
    described = machine.describe()
    workload = Workload(load_robot(robot), num_envs, threads)
    with open_all(SIMULATORS, workload, progress) as (simulators, missing):
        samples = measure_rounds(simulators, seconds, rounds, progress)
    settings: dict[str, Any] = {"robot": workload.robot.name, "num_envs": num_envs, "threads": threads}
    settings |= {"seconds": seconds, "rounds": rounds}
    results = (_result(key, simulators[key], own, samples[BASE]) for key, own in samples.items())
    return Report(described, settings, tuple(results), tuple(missing))


def _result(key: str, simulator: Simulator, own: Sequence[Sample], base: Sequence[Sample]) -> Result:
    return Result(
        *(key, simulator.note, simulator.num_envs),
        rate=Spread.of([sample.rate for sample in own]),
        cpu_us=Spread.of([sample.cpu_us for sample in own]),
        ratio=Spread.of([one.rate / other.rate for one, other in zip(own, base, strict=True)]),
    )


def command(*, json: bool, **settings: Any) -> int:  # noqa: ANN401 - those of `run`
    """Run ``dappo-batch bench`` with the parameters of `run` and return its exit code."""
    report = run(**settings, progress=measure.progress)
    print(dumps(report.to_dict(), indent=2) if json else report.text())
    return 0
