"""The report of a benchmark of training, as a table and as JSON."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

from dappo_batch import machine
from dappo_batch.bench.measure import Spread, align

from .. import rounds
from ..matmul import gflops
from ..rounds import ratios
from .bound import Bound, Rates, bound_of
from .trainers import EnvPoolTorch, Sample, StableBaselines, Trainer

__all__ = ["PEERS", "Result", "Round", "TrainingReport", "results"]

PEERS = (StableBaselines.key, EnvPoolTorch.key)
"""Keys of the trainers with which all others are compared, if they were measured."""


Round: TypeAlias = rounds.Round[Rates, Sample]


@dataclass(frozen=True)
class Result:
    """The results of one trainer; times are those of one iteration.

    Attributes
    ----------
    rate : Spread
        Env steps of complete training per second.
    rollout_seconds, update_seconds : Spread
        Time for collecting and for updating, s.
    ratios : dict
        `rate` divided by that of each measured trainer of `PEERS`, round by round.
    physics : str
        Simulator whose rate defines the bound of the rollout.
    bound_rollout_seconds, bound_update_seconds : Spread
        The parts of the bound, s.
    over_bound : Spread
        Time divided by the bound, round by round.
    """

    key: str
    about: str
    note: str
    num_envs: int
    horizon: int
    rate: Spread
    rollout_seconds: Spread
    update_seconds: Spread
    ratios: dict[str, Spread]
    physics: str
    bound_rollout_seconds: Spread
    bound_update_seconds: Spread
    over_bound: Spread


def results(turns: Sequence[Round], trainers: Sequence[Trainer]) -> tuple[Result, ...]:
    """Summarise the rounds of each trainer."""
    return tuple(_result(turns, trainer) for trainer in trainers)


def _result(turns: Sequence[Round], trainer: Trainer) -> Result:
    samples = [one.samples[trainer.key] for one in turns]
    bounds = [bound_of(one.samples[trainer.key], trainer.physics, one.machine) for one in turns]
    pairs = list(zip(samples, bounds, strict=True))

    def spread(number: Callable[[Sample, Bound], float]) -> Spread:
        return Spread.of([number(sample, bound) for sample, bound in pairs])

    return Result(
        key=trainer.key,
        about=trainer.about,
        note=trainer.note,
        num_envs=trainer.num_envs,
        horizon=trainer.horizon,
        rate=spread(lambda sample, _: sample.rate),
        rollout_seconds=spread(lambda sample, _: sample.rollout_seconds / sample.iterations),
        update_seconds=spread(lambda sample, _: sample.update_seconds / sample.iterations),
        ratios=ratios(turns, trainer.key, PEERS),
        physics=trainer.physics,
        bound_rollout_seconds=spread(lambda _, bound: bound.rollout_seconds),
        bound_update_seconds=spread(lambda _, bound: bound.update_seconds),
        over_bound=spread(lambda sample, bound: sample.seconds / sample.iterations / bound.seconds),
    )


@dataclass(frozen=True)
class TrainingReport(rounds.Report):
    """The report of ``python -m tests.bench.training``.

    Attributes
    ----------
    results : tuple of Result
        The measured trainers.
    sgemm : Spread
        Floating-point operations per second in multiplications of float32 matrices.
    sgemm_note : str
        Library and threads of the multiplications.
    physics : dict
        Env steps per second of simulators, by key.
    """

    results: tuple[Result, ...]
    sgemm: Spread
    sgemm_note: str
    physics: dict[str, Spread]

    def parts(self) -> tuple[str, ...]:
        """Return the paragraphs of the text, the bound last."""
        return self._head(), self._table(), self._legend(), self._bound()

    def _head(self) -> str:
        settings = self.settings
        return (
            f"{machine.text(self.machine)}\n"
            f"PPO on the healthy Ant: batch of {settings['num_envs']} envs x {settings['horizon']} steps, "
            f"{settings['epochs']} epochs in minibatches of {settings['minibatch']}, "
            f"two nets of {'-'.join(map(str, settings['hidden']))} tanh units\n"
            f"{settings['threads']} threads, {settings['rounds']} rounds of {settings['iterations']} "
            "iterations, medians (lowest to highest); seconds are those of one iteration"
        )

    def _table(self) -> str:
        peers = [peer for peer in PEERS if self.results and peer in self.results[0].ratios]
        head = ["", "env steps/s", "rollout s", "update s", *(f"speed / {peer}" for peer in peers)]
        rows = [[*head, "bound s", "time / bound"]]
        for one in self.results:
            bound = one.bound_rollout_seconds.median + one.bound_update_seconds.median
            rows.append(
                [
                    one.key,
                    one.rate.text(",.0f"),
                    one.rollout_seconds.text(".2f"),
                    one.update_seconds.text(".2f"),
                    *(one.ratios[peer].text(".2f") for peer in peers),
                    f"{bound:.2f}",
                    one.over_bound.text(".2f"),
                ]
            )
        return align(rows)

    def _legend(self) -> str:
        width = max((len(one.key) for one in self.results), default=0)
        return "\n".join(
            f"{one.key.ljust(width)}  {one.about}; {one.num_envs} envs x {one.horizon} steps"
            f"{f' ({one.note})' if one.note else ''}"
            for one in self.results
        )

    def _bound(self) -> str:
        physics = ", ".join(f"{key} {rate.text(',.0f')}" for key, rate in self.physics.items())
        lines = [
            f"sgemm: {gflops(self.sgemm)} Gflop/s, {self.sgemm_note}",
            f"physics, env steps/s: {physics}",
            "bound = env steps / physics + flops of the update / sgemm:",
        ]
        lines += [
            f"  {one.key}: {one.bound_rollout_seconds.median:.3f} s of {one.physics} "
            f"+ {one.bound_update_seconds.median:.3f} s of sgemm"
            for one in self.results
        ]
        return "\n".join(lines)
