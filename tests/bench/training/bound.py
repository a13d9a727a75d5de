"""Upper bounds of the machine: its rates of matrix multiplications and of physics."""

from __future__ import annotations

import time
from dataclasses import dataclass

from dappo_batch.bench.measure import WARM_UP_STEPS
from dappo_batch.bench.simulators import SIMULATORS, Workload
from dappo_batch.robots import load_robot

from ..matmul import SgemmBenchmark
from .task import Task
from .trainers import Sample

__all__ = ["Bound", "Machine", "Rates", "bound_of"]

_LANE_ENVS = 4096


@dataclass(frozen=True)
class Rates:
    """The rates of the machine in one round.

    Attributes
    ----------
    sgemm : float
        Floating-point operations per second in multiplications of float32 matrices.
    physics : dict
        Env steps per second of simulators of `dappo_batch.bench`, by key.
    """

    sgemm: float
    physics: dict[str, float]


@dataclass(frozen=True)
class Bound:
    """The minimum time of one iteration, s, if only physics and matrix multiplications took time."""

    rollout_seconds: float
    update_seconds: float

    @property
    def seconds(self) -> float:
        """Time of the iteration."""
        return self.rollout_seconds + self.update_seconds


def bound_of(sample: Sample, physics: str, rates: Rates) -> Bound:
    """Return the bound of an iteration of `sample`: env steps / physics rate + flops / sgemm rate.

    The networks' passes in the rollout, a thirtieth of those of an update with ten epochs, are not counted.
    """
    return Bound(
        rollout_seconds=sample.env_steps / sample.iterations / rates.physics[physics],
        update_seconds=sample.update_flops / sample.iterations / rates.sgemm,
    )


class Machine:
    """Measures `Rates`."""

    def __init__(self, task: Task) -> None:
        workload = Workload(load_robot("ant"), _LANE_ENVS, task.threads, task.seed)
        self._physics = {key: SIMULATORS[key](workload) for key in ("mj_step", "lanes f32")}
        for simulator in self._physics.values():
            simulator.run_for(0.0, WARM_UP_STEPS)
        self._sgemm = SgemmBenchmark(task.threads)
        self.note = self._sgemm.note

    def measure(self, seconds: float) -> Rates:
        """Measure each rate for at least `seconds`."""
        rates = {}
        for key, simulator in self._physics.items():
            start = time.perf_counter()
            steps = simulator.run_for(seconds)
            rates[key] = steps / (time.perf_counter() - start)
        return Rates(self._sgemm.measure(seconds), rates)

    def close(self) -> None:
        """Free processes and memory."""
        self._sgemm.close()
        for simulator in self._physics.values():
            simulator.close()
