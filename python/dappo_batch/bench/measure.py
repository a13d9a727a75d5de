"""Interleaved timing: every round measures every simulator, in rotating order."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from statistics import median
from typing import Protocol, TypeVar

from dappo_batch._core import ConfigError
from dappo_batch.bench.simulators import Simulator, Unavailable

__all__ = [
    "WARM_UP_STEPS",
    "Missing",
    "Sample",
    "Spread",
    "align",
    "check",
    "measure_rounds",
    "open_all",
    "progress",
    "rotated",
]

_T = TypeVar("_T")
_W = TypeVar("_W")
_C = TypeVar("_C", bound="_Closed")

WARM_UP_STEPS = 40
"""Env steps before the first sample: robots start above the floor, and contacts cost time."""


class _Closed(Protocol):
    def close(self) -> None: ...


@dataclass(frozen=True)
class Missing:
    """A simulator that was not measured, the reason, and the command that installs it, if there is one."""

    key: str
    reason: str
    install: str

    def __str__(self) -> str:
        cure = f"; to install it: {self.install}" if self.install else ""
        return f"not measured: {self.key}: {self.reason}{cure}"


def check(counts: Mapping[str, Sequence[int]], seconds: float) -> None:
    """Raise `ConfigError` if a count is below 1 or the time is not positive and finite."""
    for name, values in counts.items():
        if min(values, default=0) < 1:
            raise ConfigError(f"{name} must be at least 1, got {min(values, default='nothing')}")
    if not 0.0 < seconds < float("inf"):
        raise ConfigError(f"seconds must be above 0, got {seconds}")


@contextmanager
def open_all(
    makers: Mapping[str, Callable[[_W], _C]], work: _W, progress: Callable[[str], None]
) -> Iterator[tuple[dict[str, _C], list[Missing]]]:
    """Create the simulators that can run here, list the others as `Missing`, and close them at the end.

    Makers raise `Unavailable` if their simulator cannot run.
    """
    made: dict[str, _C] = {}
    missing: list[Missing] = []
    with ExitStack() as stack:
        for key, make in makers.items():
            progress(f"starting {key}")
            try:
                made[key] = make(work)
            except Unavailable as reason:
                missing.append(Missing(key, str(reason), reason.install))
            else:
                stack.callback(made[key].close)
        yield made, missing


@dataclass(frozen=True)
class Sample:
    """One simulator in one round: env steps, elapsed time, and processor time of all threads, s."""

    steps: int
    wall_seconds: float
    cpu_seconds: float

    @property
    def rate(self) -> float:
        """Env steps per second of elapsed time."""
        return self.steps / self.wall_seconds

    @property
    def cpu_us(self) -> float:
        """Processor time of an env step, µs."""
        return 1e6 * self.cpu_seconds / self.steps


@dataclass(frozen=True)
class Spread:
    """Median and range of a sample."""

    median: float
    low: float
    high: float

    @classmethod
    def of(cls, values: Sequence[float]) -> Spread:
        """Summarise at least one value."""
        return cls(median(values), min(values), max(values))

    def text(self, format_spec: str) -> str:
        """Return the median, and the range in brackets."""
        median, low, high = (format(value, format_spec) for value in (self.median, self.low, self.high))
        return f"{median} ({low} to {high})"


def measure_rounds(
    simulators: Mapping[str, Simulator], seconds: float, rounds: int, progress: Callable[[str], None]
) -> dict[str, list[Sample]]:
    """Time all simulators `rounds` times, each for at least `seconds`, and return their samples.

    The load of the machine affects all samples of a round alike, so numbers are compared within a round. The
    order rotates.
    """
    for key, simulator in simulators.items():
        progress(f"warming up {key}")
        simulator.run_for(0.0, WARM_UP_STEPS)
    samples: dict[str, list[Sample]] = {key: [] for key in simulators}
    for number in range(rounds):
        for key in rotated([*simulators], number):
            progress(f"round {number + 1} of {rounds}: {key}")
            cpu, wall = time.process_time(), time.perf_counter()
            steps = simulators[key].run_for(seconds)
            samples[key].append(Sample(steps, time.perf_counter() - wall, time.process_time() - cpu))
    return samples


def rotated(entries: Sequence[_T], number: int) -> list[_T]:
    """Return `entries` in the order of round `number`, as each affects the caches of the next."""
    shift = number % max(1, len(entries))
    return [*entries[shift:], *entries[:shift]]


def progress(what: str) -> None:
    """Replace the status line on a terminal."""
    if sys.stderr.isatty():
        print(f"\r\x1b[K{what} …", end="", file=sys.stderr, flush=True)


def align(rows: Sequence[Sequence[str]]) -> str:
    """Align cells in columns: the first to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for first, *others in rows:
        cells = (cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True))
        lines.append("  ".join([first.ljust(widths[0]), *cells]).rstrip())
    return "\n".join(lines)
