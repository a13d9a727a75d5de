"""The machine's rate of matrix multiplications, which bounds every training."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from dappo_batch.bench.measure import Spread

from .worker import Worker

__all__ = ["Sgemm", "SgemmBenchmark", "Threads", "gflops"]

_SIZE = 1024


@dataclass(frozen=True)
class Threads:
    """The number of threads of a worker."""

    threads: int


class Sgemm:
    """NumPy's product of square float32 matrices, as a program of a worker."""

    def __init__(self, _: Threads) -> None:
        rng = np.random.default_rng(0)
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


def gflops(rate: Spread) -> str:
    """Return a rate in operations per second as a text in Gflop/s."""
    return Spread(*(1e-9 * value for value in (rate.median, rate.low, rate.high))).text(".1f")


class SgemmBenchmark:
    """Measures the rate of `Sgemm` with one thread and with several; the faster one counts."""

    def __init__(self, threads: int) -> None:
        # Also one thread: on a busy machine it can be faster than several, which wait for each other.
        counts = sorted({1, threads})
        self._workers = [Worker("tests.bench.matmul:Sgemm", Threads(count)) for count in counts]
        best = f"best of {' and '.join(map(str, counts))} threads" if len(counts) > 1 else "1 thread"
        self.note = f"{self._workers[0].note}, {best}"

    def measure(self, seconds: float) -> float:
        """Multiply for at least `seconds` with each number of threads; returns operations per second."""
        return max(float(worker.ask(seconds)["flops"]) for worker in self._workers)

    def close(self) -> None:
        """Free processes and memory."""
        for worker in self._workers:
            worker.close()
