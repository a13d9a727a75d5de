"""What the machine could do at best: its rates of matrix products and of physics."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from dappo_batch.bench.contenders import Contender, LanesF32, RawStep
from dappo_batch.bench.products import Products
from dappo_batch.bench.training.task import Task
from dappo_batch.bench.training.trainers import Sample
from dappo_batch.bench.workload import Workload

__all__ = ["Bound", "Machine", "Rates", "bound_of"]

_LANE_ENVS = 4096


@dataclass(frozen=True)
class Rates:
    """What the machine did in one round.

    Attributes
    ----------
    sgemm : float
        Floating-point operations per second in products of float32 matrices.
    physics : dict
        Env steps per second of contenders of `dappo_batch.bench` that do little else, by key.
    """

    sgemm: float
    physics: dict[str, float]


@dataclass(frozen=True)
class Bound:
    """The least time of one iteration, s, if nothing but physics and matrix products took time."""

    rollout_seconds: float
    update_seconds: float

    @property
    def seconds(self) -> float:
        """Time of the iteration."""
        return self.rollout_seconds + self.update_seconds


def bound_of(sample: Sample, physics: str, rates: Rates) -> Bound:
    """Return the bound of an iteration of `sample`: env steps / physics rate + flops / sgemm rate.

    The networks' passes in the rollout, a thirtieth of those of an update with ten epochs, are left out.
    """
    return Bound(
        rollout_seconds=sample.env_steps / sample.iterations / rates.physics[physics],
        update_seconds=sample.update_flops / sample.iterations / rates.sgemm,
    )


class Machine:
    """Measures `Rates`."""

    def __init__(self, task: Task) -> None:
        kinds: Sequence[type[Contender]] = (RawStep, LanesF32)
        workload = Workload.of("ant", _LANE_ENVS, task.threads, task.seed)
        self._physics = [kind(workload) for kind in kinds]
        for contender in self._physics:
            contender.warm_up()
        self._products = Products(task.threads)
        self.note = self._products.note

    def measure(self, seconds: float) -> Rates:
        """Measure each rate for at least `seconds`."""
        rates = {}
        for contender in self._physics:
            start = time.perf_counter()
            steps = contender.run_for(seconds)
            rates[contender.key] = steps / (time.perf_counter() - start)
        return Rates(self._products.measure(seconds), rates)

    def close(self) -> None:
        """Free processes and memory."""
        self._products.close()
        for contender in self._physics:
            contender.close()
