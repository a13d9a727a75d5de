"""Trainings in turn: everybody in every round, in rotating order, and numbers that compare within a round."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Generic, Protocol, TypeVar

from dappo_batch._core import ConfigError
from dappo_batch.bench import Missing
from dappo_batch.bench.measure import Spread, rotated

from .entry import Entrant

__all__ = ["Machine", "Report", "Round", "Sample", "Trainer", "check", "measure_rounds", "ratios"]

_PAUSE = 0.3  # s; threads of OpenMP go on spinning for a while when their work is done


class Sample(Protocol):
    """What a contender did in a round."""

    @property
    def rate(self) -> float:
        """What is compared, per second."""


R = TypeVar("R")
R_co = TypeVar("R_co", covariant=True)
S = TypeVar("S", bound=Sample)


class Machine(Protocol[R_co]):
    """Measures what bounds every contender."""

    def measure(self, seconds: float) -> R_co:
        """Measure for at least `seconds`."""


class Trainer(Entrant, ABC, Generic[S]):
    """A contender that trains."""

    @abstractmethod
    def train(self, amount: int) -> S:
        """Train for `amount` iterations or epochs, none of which warms up."""


@dataclass(frozen=True)
class Round(Generic[R, S]):
    """A sample of everything, taken one after the other: the machine, and each contender by its key."""

    machine: R
    samples: dict[str, S]


def check(counts: Mapping[str, Sequence[int]], seconds: float) -> None:
    """Refuse counts below 1 by their names, and a time that is none.

    Raises
    ------
    ConfigError
        If there is one.
    """
    for name, values in counts.items():
        if min(values, default=0) < 1:
            raise ConfigError(f"{name} must be at least 1, got {min(values, default='nothing')}")
    if not 0.0 < seconds < float("inf"):
        raise ConfigError(f"seconds must be above 0, got {seconds}")


def measure_rounds(
    machine: Machine[R],
    trainers: Sequence[Trainer[S]],
    amount: int,
    rounds: int,
    seconds: float,
    progress: Callable[[str], None],
) -> list[Round[R, S]]:
    """Measure everything `rounds` times; the order of the trainers rotates."""
    found = []
    for number in range(rounds):
        where = f"round {number + 1} of {rounds}"
        progress(f"{where}: the machine")
        time.sleep(_PAUSE)
        measured = machine.measure(seconds)
        samples = {}
        for trainer in rotated(trainers, number):
            progress(f"{where}: {trainer.key}")
            time.sleep(_PAUSE)
            samples[trainer.key] = trainer.train(amount)
        found.append(Round(measured, samples))
    return found


def ratios(rounds: Sequence[Round[R, S]], key: str, peers: Sequence[str]) -> dict[str, Spread]:
    """Return a contender's rate in terms of each of the peers that was measured, compared round by round."""
    return {
        peer: Spread.of([one.samples[key].rate / one.samples[peer].rate for one in rounds])
        for peer in peers
        if peer in rounds[0].samples
    }


@dataclass(frozen=True)
class Report(ABC):
    """Everything that one call found.

    Attributes
    ----------
    machine : dict
        Processor, cores, load average before the first sample, versions.
    settings : dict
        What was trained, how much of it a sample, seconds of a sample of the machine, rounds.
    missing : tuple of Missing
        The contenders that were not measured, and why.
    """

    machine: dict[str, Any]
    settings: dict[str, Any]
    missing: tuple[Missing, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON can hold it."""
        return asdict(self)

    def text(self) -> str:
        """Return everything as a text for people."""
        missing = "\n".join(map(str, self.missing))
        parts = (self._head(), self._table(), self._legend(), missing, self._bound())
        return "\n\n".join(part for part in parts if part)

    @abstractmethod
    def _head(self) -> str: ...

    @abstractmethod
    def _table(self) -> str: ...

    @abstractmethod
    def _legend(self) -> str: ...

    @abstractmethod
    def _bound(self) -> str: ...
