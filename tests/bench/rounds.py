"""Trainings in turn: everybody in every round, in rotating order, and numbers that compare within a round."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Generic, Protocol, TypeVar

from dappo_batch.bench.measure import Missing, Spread, rotated

from .entry import Entrant

__all__ = ["Report", "Round", "Trainer", "measure_rounds", "ratios"]

_PAUSE = 0.3  # s; threads of OpenMP go on spinning for a while when their work is done


class Sample(Protocol):
    """What a contender did in a round."""

    @property
    def rate(self) -> float:
        """What is compared, per second."""


R = TypeVar("R")
S = TypeVar("S", bound=Sample)


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


def measure_rounds(
    machine: Callable[[float], R],
    trainers: Sequence[Trainer[S]],
    amount: int,
    rounds: int,
    seconds: float,
    progress: Callable[[str], None],
) -> list[Round[R, S]]:
    """Measure everything `rounds` times, the machine for `seconds`; the order of the trainers rotates."""
    found = []
    for number in range(rounds):
        where = f"round {number + 1} of {rounds}"
        progress(f"{where}: the machine")
        time.sleep(_PAUSE)
        measured = machine(seconds)
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
        *parts, bound = self.parts()
        return "\n\n".join(part for part in (*parts, "\n".join(map(str, self.missing)), bound) if part)

    @abstractmethod
    def parts(self) -> tuple[str, ...]:
        """Return the paragraphs of the text, the bound last."""
