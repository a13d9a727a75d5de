"""Interleaved trainings: every round measures every trainer, in rotating order."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Generic, Protocol, TypeVar

from dappo_batch.bench.measure import Missing, Spread, rotated

from .entry import Entry

__all__ = ["Report", "Round", "Trainer", "measure_rounds", "ratios"]

_PAUSE = 0.3  # s; threads of OpenMP keep spinning for a while after their work


class Sample(Protocol):
    """The measurement of a trainer in a round."""

    @property
    def rate(self) -> float:
        """The compared quantity per second."""


R = TypeVar("R")
S = TypeVar("S", bound=Sample)


class Trainer(Entry, ABC, Generic[S]):
    """An entry that trains."""

    @abstractmethod
    def train(self, amount: int) -> S:
        """Train for `amount` iterations or epochs, not counting a warm-up."""


@dataclass(frozen=True)
class Round(Generic[R, S]):
    """The samples of one round: the machine, and each trainer by its key."""

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
    """Return the ratios of a trainer's rate to those of the measured peers, round by round."""
    return {
        peer: Spread.of([one.samples[key].rate / one.samples[peer].rate for one in rounds])
        for peer in peers
        if peer in rounds[0].samples
    }


@dataclass(frozen=True)
class Report(ABC):
    """The results of one call.

    Attributes
    ----------
    machine : dict
        Processor, cores, load average before the first sample, versions.
    settings : dict
        The training, the size of a sample, seconds of a sample of the machine, rounds.
    missing : tuple of Missing
        The trainers that were not measured, with reasons.
    """

    machine: dict[str, Any]
    settings: dict[str, Any]
    missing: tuple[Missing, ...]

    def to_dict(self) -> dict[str, Any]:
        """Return the report as a dictionary that can be written as JSON."""
        return asdict(self)

    def text(self) -> str:
        """Return the report as text."""
        *parts, bound = self.parts()
        return "\n\n".join(part for part in (*parts, "\n".join(map(str, self.missing)), bound) if part)

    @abstractmethod
    def parts(self) -> tuple[str, ...]:
        """Return the paragraphs of the text, the bound last."""
