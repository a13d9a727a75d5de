"""What the machine could do at best: its rates of matrix products and of physics."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from dappo_batch.bench.contenders import Contender, LanesF32, RawStep
from dappo_batch.bench.training.task import Task
from dappo_batch.bench.training.trainers import Sample
from dappo_batch.bench.training.worker import Worker
from dappo_batch.bench.workload import Workload

__all__ = ["Bound", "Machine", "Products", "Rates", "Sgemm", "bound_of"]

_SIZE = 1024
_LANE_ENVS = 4096


class Sgemm:
    """NumPy's product of square float32 matrices, as a program of a worker."""

    def __init__(self, task: Task) -> None:
        rng = np.random.default_rng(task.seed)
        self._left, self._right = rng.standard_normal((2, _SIZE, _SIZE), dtype=np.float32)
        self._out = np.empty_like(self._left)
        self.note = f"numpy {np.__version__} with {_blas()}"
        self.answer(0.0)

    def answer(self, number: float) -> dict[str, Any]:
        """Multiply for at least `number` seconds; returns ``flops``, floating-point operations per second."""
        start, count, elapsed = time.perf_counter(), 0, 0.0
        while count == 0 or elapsed < number:
            np.matmul(self._left, self._right, out=self._out)
            count, elapsed = count + 1, time.perf_counter() - start
        return {"flops": 2.0 * _SIZE**3 * count / elapsed}

    def close(self) -> None:
        """Free processes and memory."""


def _blas() -> str:
    """Return the name and version of the library that multiplies NumPy's matrices."""
    known: Any = np.show_config(mode="dicts")
    blas = known.get("Build Dependencies", {}).get("blas", {})
    return f"{blas.get('name', 'unknown BLAS')} {blas.get('version', '')}".strip()


class Products:
    """Measures the rate of `Sgemm` with one thread and with all of a task; the faster counts."""

    def __init__(self, task: Task) -> None:
        # One thread too: on a busy machine it may do more than several, which wait for each other.
        counts = sorted({1, task.threads})
        self._workers = [Worker(f"{__name__}:Sgemm", replace(task, threads=count)) for count in counts]
        best = f"best of {' and '.join(map(str, counts))} threads" if len(counts) > 1 else "1 thread"
        self.note = f"{self._workers[0].note}, {best}"

    def measure(self, seconds: float) -> float:
        """Multiply for at least `seconds` with each number of threads; returns operations per second."""
        return max(float(worker.ask(seconds)["flops"]) for worker in self._workers)

    def close(self) -> None:
        """Free processes and memory."""
        for worker in self._workers:
            worker.close()


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
        self._products = Products(task)
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
