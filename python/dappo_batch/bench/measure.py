"""Interleaved timing: every contender in every round, in rotating order."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from statistics import median
from typing import Protocol, TypeVar

from dappo_batch._core import ConfigError
from dappo_batch.bench.contenders import Contender, Unavailable

__all__ = [
    "SETTLING_STEPS",
    "Missing",
    "Sample",
    "Spread",
    "align",
    "check",
    "enter",
    "measure_rounds",
    "progress",
    "rotated",
]

_T = TypeVar("_T")
_W = TypeVar("_W")
_C = TypeVar("_C", bound="_Closed")

SETTLING_STEPS = 40
"""Env steps before the first sample. Contacts decide what a step costs, and robots begin above the floor."""


class _Closed(Protocol):
    def close(self) -> None: ...


@dataclass(frozen=True)
class Missing:
    """A contender that was not measured, why, and the command that would change it, if there is one."""

    key: str
    reason: str
    install: str

    def __str__(self) -> str:
        cure = f"; to install it: {self.install}" if self.install else ""
        return f"not measured: {self.key}: {self.reason}{cure}"


def check(counts: Mapping[str, Sequence[int]], seconds: float) -> None:
    """Raise `ConfigError` if a count is below 1 or the time is none."""
    for name, values in counts.items():
        if min(values, default=0) < 1:
            raise ConfigError(f"{name} must be at least 1, got {min(values, default='nothing')}")
    if not 0.0 < seconds < float("inf"):
        raise ConfigError(f"seconds must be above 0, got {seconds}")


@contextmanager
def enter(
    makers: Mapping[str, Callable[[_W], _C]], work: _W, progress: Callable[[str], None]
) -> Iterator[tuple[dict[str, _C], list[Missing]]]:
    """Make all contenders that can run here, say why the others cannot, and close them at the end.

    Makers raise `Unavailable` where they cannot.
    """
    made: dict[str, _C] = {}
    missing: list[Missing] = []
    with ExitStack() as entered:
        for key, make in makers.items():
            progress(f"making {key}")
            try:
                made[key] = make(work)
            except Unavailable as reason:
                missing.append(Missing(key, str(reason), reason.install))
            else:
                entered.callback(made[key].close)
        yield made, missing


@dataclass(frozen=True)
class Sample:
    """One contender's share of one round: env steps, elapsed time, and processor time of all threads, s."""

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
    """Median and range of a few numbers."""

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
    contenders: Mapping[str, Contender], seconds: float, rounds: int, progress: Callable[[str], None]
) -> dict[str, list[Sample]]:
    """Time all contenders `rounds` times, each for `seconds` at least, and return their samples.

    Whatever else the machine does meanwhile affects neighbours in a round alike, so numbers are compared
    within a round. The order rotates.
    """
    for key, contender in contenders.items():
        progress(f"warming up {key}")
        contender.run_for(0.0, SETTLING_STEPS)
    samples: dict[str, list[Sample]] = {key: [] for key in contenders}
    for number in range(rounds):
        for key in rotated([*contenders], number):
            progress(f"round {number + 1} of {rounds}: {key}")
            cpu, wall = time.process_time(), time.perf_counter()
            steps = contenders[key].run_for(seconds)
            samples[key].append(Sample(steps, time.perf_counter() - wall, time.process_time() - cpu))
    return samples


def rotated(entrants: Sequence[_T], number: int) -> list[_T]:
    """Return everybody in the order of round `number`: each leaves caches behind for the next."""
    shift = number % max(1, len(entrants))
    return [*entrants[shift:], *entrants[:shift]]


def progress(what: str) -> None:
    """Show on a terminal what happens, in the line that showed what happened before."""
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
