"""Minibatches of a dataset as in ``dappo-batch diagnose train``, read with NumPy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .task import Task

__all__ = ["Windows"]

_CLIP = 10.0  # standard deviations
_ROUNDING = 1e-6  # smaller deviations, relative to means above 1, are rounding errors
_MAX_WINDOWS = 4096  # for mean and standard deviation


class Windows:
    """Differences between the observations of twin and damaged robot, standardised; a window is a sample.

    Attributes
    ----------
    mean, scale : array of shape [O]
        Mean and 1 / standard deviation of evenly spaced samples; 0 for constant entries.
    """

    def __init__(self, task: Task) -> None:
        self._task = task
        (path,) = Path(task.data).glob("rollouts-*.npy")
        self._runs: NDArray[Any] = np.load(path, mmap_mode="r")["damaged"]
        spacing = -(-task.samples // _MAX_WINDOWS)
        measured = self._raw(np.arange(0, task.samples, spacing)).reshape(-1, task.inputs)
        mean, deviation = measured.mean(0, dtype=np.float64), measured.std(0, dtype=np.float64)
        varies = deviation > _ROUNDING * np.maximum(np.abs(mean), 1.0)
        self.mean = mean.astype(np.float32)
        self.scale = np.divide(1.0, deviation, out=np.zeros_like(mean), where=varies).astype(np.float32)

    def classes(self, samples: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the damage classes of samples [B]."""
        return samples % self._task.classes

    def _raw(self, samples: NDArray[np.int64]) -> NDArray[np.float32]:
        """Read samples [B] from the file, [B, T, O]. The run of class 0 is the twin of the others."""
        rollouts, steps = samples // self._task.classes, self._task.timesteps
        damaged: NDArray[np.float32] = self._runs[rollouts, self.classes(samples), :steps]
        twin: NDArray[np.float32] = self._runs[rollouts, 0, :steps]
        return np.subtract(twin, damaged, out=twin)

    def read(self, samples: NDArray[np.int64]) -> NDArray[np.float32]:
        """Read samples [B], numbered with the class varying fastest, as inputs [B, T, O]."""
        inputs = self._raw(samples)
        inputs -= self.mean
        inputs *= self.scale
        return np.clip(inputs, -_CLIP, _CLIP, out=inputs)
