"""``dappo-batch bench``: env steps per second and processor time beside other simulators.

Everything runs in one process, interleaved, with the same kind of states and actions, so the ratios
hold on a busy or throttled machine too; the absolute numbers are those of the moment.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from json import dumps
from typing import Any

from dappo_batch import machine
from dappo_batch.bench import measure
from dappo_batch.bench.contenders import CONTENDERS, Contender, Workload
from dappo_batch.bench.measure import Missing, Sample, Spread, align, check, enter, measure_rounds
from dappo_batch.robots import load_robot

__all__ = ["BASE", "Missing", "Report", "Result", "command", "run"]

BASE = "mj_step"
"""Name of the contender that all others are compared with."""


@dataclass(frozen=True)
class Result:
    """One contender's numbers.

    ``rate`` is in env steps per second of elapsed time, ``ratio`` the same over that of `BASE`, compared
    round by round, ``cpu_us`` the processor time of an env step in µs.
    """

    key: str
    note: str
    num_envs: int
    rate: Spread
    cpu_us: Spread
    ratio: Spread


@dataclass(frozen=True)
class Report:
    """Everything that one call found: the machine, the settings, results, and what is missing and why."""

    machine: dict[str, Any]
    settings: dict[str, Any]
    results: tuple[Result, ...]
    missing: tuple[Missing, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON can hold it."""
        return asdict(self) | {"base": BASE}

    def text(self) -> str:
        """Return everything as a text for people."""
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
    progress : callable
        Told what happens, for example ``print``.

    Raises
    ------
    ConfigError
        If an argument is out of range or the robot unknown.
    """
    threads = machine.cores() if threads is None else threads
    check({"num_envs": [num_envs], "threads": [threads], "rounds": [rounds]}, seconds)
    described = machine.describe()
    workload = Workload(load_robot(robot), num_envs, threads)
    with enter(CONTENDERS, workload, progress) as (contenders, missing):
        samples = measure_rounds(contenders, seconds, rounds, progress)
    settings: dict[str, Any] = {"robot": workload.robot.name, "num_envs": num_envs, "threads": threads}
    settings |= {"seconds": seconds, "rounds": rounds}
    results = (_result(key, contenders[key], own, samples[BASE]) for key, own in samples.items())
    return Report(described, settings, tuple(results), tuple(missing))


def _result(key: str, contender: Contender, own: Sequence[Sample], base: Sequence[Sample]) -> Result:
    return Result(
        *(key, contender.note, contender.num_envs),
        rate=Spread.of([sample.rate for sample in own]),
        cpu_us=Spread.of([sample.cpu_us for sample in own]),
        ratio=Spread.of([one.rate / other.rate for one, other in zip(own, base, strict=True)]),
    )


def command(*, json: bool, **settings: Any) -> int:  # noqa: ANN401 - those of `run`
    """Run ``dappo-batch bench`` with the parameters of `run` and return its exit code."""
    report = run(**settings, progress=measure.progress)
    print(dumps(report.to_dict(), indent=2) if json else report.text())
    return 0
