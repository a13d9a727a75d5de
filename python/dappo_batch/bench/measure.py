"""Interleaved timing: every contender in every round, in rotating order."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import TypeVar

from dappo_batch._core import SimulationError
from dappo_batch.bench.contenders import Contender

__all__ = ["Sample", "Spread", "measure_rounds", "peak_memory_mb", "ratios", "rotated"]

T = TypeVar("T")


@dataclass(frozen=True)
class Sample:
    """One contender's share of one round.

    Attributes
    ----------
    steps : int
        Env steps.
    wall_seconds : float
        Elapsed time.
    cpu_seconds : float
        Processor time of all threads.
    """

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

    def scaled(self, factor: float) -> Spread:
        """Return the same in another unit."""
        return Spread(factor * self.median, factor * self.low, factor * self.high)

    def text(self, format_spec: str) -> str:
        """Return the median, and the range in brackets."""
        median, low, high = (format(value, format_spec) for value in (self.median, self.low, self.high))
        return f"{median} ({low} to {high})"


def _cpu_seconds() -> float:
    """Return the processor time of this process, all threads and finished children included."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def rotated(contenders: Sequence[T], number: int) -> list[T]:
    """Return everybody in the order of round `number`: each leaves caches behind for the next."""
    shift = number % max(1, len(contenders))
    return [*contenders[shift:], *contenders[:shift]]


def measure_rounds(
    contenders: Sequence[Contender],
    seconds: float,
    rounds: int,
    progress: Callable[[str], None] = lambda _: None,
) -> dict[str, list[Sample]]:
    """Time all contenders `rounds` times.

    Whatever else the machine does meanwhile, and however its clock changes, hits neighbours in a round alike;
    so numbers are compared within a round. The order rotates, see `rotated`.

    Parameters
    ----------
    contenders : sequence of Contender
        What to time; each is warmed up first.
    seconds : float
        Least length of a sample, s. A contender finishes the env step it has begun.
    rounds : int
        Samples a contender.
    progress : callable, optional
        Told what happens, for example ``print``.

    Returns
    -------
    dict
        The samples of each contender by its key, in the order of rounds.
    """
    for contender in contenders:
        progress(f"warming up {contender.key}")
        contender.warm_up()
    samples: dict[str, list[Sample]] = {contender.key: [] for contender in contenders}
    for number in range(rounds):
        for contender in rotated(contenders, number):
            progress(f"round {number + 1} of {rounds}: {contender.key}")
            cpu, wall = _cpu_seconds(), time.perf_counter()
            steps = contender.run_for(seconds)
            sample = Sample(steps, time.perf_counter() - wall, _cpu_seconds() - cpu)
            samples[contender.key].append(sample)
    return samples


def ratios(samples: Sequence[Sample], base: Sequence[Sample], number: Callable[[Sample], float]) -> Spread:
    """Compare two contenders round by round: `number` of one over `number` of the other."""
    return Spread.of([number(one) / number(other) for one, other in zip(samples, base, strict=True)])


_MEMORY_SCRIPT = """\
import json, sys
import numpy as np
import dappo_batch
from dappo_batch.bench.measure import own_peak_memory_mb
robot, num_envs, threads = json.loads(sys.argv[1])
envs = dappo_batch.make_vec(robot, num_envs, seed=0, threads=threads, copy=False)
envs.reset()
actions = np.zeros(envs.action_space.shape, dtype=np.float32)
for _ in range(3):
    envs.step(actions)
print(json.dumps(own_peak_memory_mb()))
"""


def peak_memory_mb(robot: str, num_envs: int, threads: int) -> float:
    """Return the peak memory of a process that makes environments and steps them, MB (10⁶ bytes).

    Raises
    ------
    SimulationError
        If that process fails.
    """
    arguments = json.dumps([robot, num_envs, threads])
    done = subprocess.run(
        [sys.executable, "-c", _MEMORY_SCRIPT, arguments], capture_output=True, text=True, check=False
    )
    if done.returncode != 0:
        raise SimulationError(f"the process that measures memory failed: {done.stderr.strip()[-500:]}")
    return float(json.loads(done.stdout.splitlines()[-1]))


def own_peak_memory_mb() -> float:
    """Return the largest resident memory this process ever had, MB."""
    status = Path("/proc/self/status")
    if status.exists():
        # getrusage would answer with the parent's peak if that was larger: Linux keeps it across exec.
        for line in status.read_text(encoding="ascii").splitlines():
            if line.startswith("VmHWM:"):
                return int(line.split()[1]) * 1024 / 1e6
    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 1e6
