"""What the machine could do at best: its rates of matrix products and of physics."""

from __future__ import annotations

import time
from dataclasses import dataclass

from dappo_batch.bench.contenders import CONTENDERS, Workload
from dappo_batch.bench.measure import SETTLING_STEPS
from dappo_batch.robots import load_robot

from ..products import Products
from .task import Task
from .trainers import Sample

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
        workload = Workload(load_robot("ant"), _LANE_ENVS, task.threads, task.seed)
        self._physics = {key: CONTENDERS[key](workload) for key in ("mj_step", "lanes f32")}
        for contender in self._physics.values():
            contender.run_for(0.0, SETTLING_STEPS)
        self._products = Products(task.threads)
        self.note = self._products.note

    def measure(self, seconds: float) -> Rates:
        """Measure each rate for at least `seconds`."""
        rates = {}
        for key, contender in self._physics.items():
            start = time.perf_counter()
            steps = contender.run_for(seconds)
            rates[key] = steps / (time.perf_counter() - start)
        return Rates(self._products.measure(seconds), rates)

    def close(self) -> None:
        """Free processes and memory."""
        self._products.close()
        for contender in self._physics.values():
            contender.close()
