"""Worlds with an untrained policy, for the phases of the check."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
import warp as wp
from numpy.typing import NDArray

from dappo_batch.kernels.captured_step import CapturedStep
from dappo_batch.kernels.policy import Policy
from dappo_batch.kernels.rollout import Rollout
from dappo_batch.kernels.task import Task
from dappo_batch.kernels.worlds import Worlds

__all__ = ["collector", "device_arrays"]


def collector(task: Task, num_envs: int, horizon: int, hidden: Sequence[int]) -> CapturedStep:
    """Return a captured step of `num_envs` worlds at the start of their first episodes."""
    keys = np.arange(num_envs, dtype=np.uint64)
    worlds = Worlds(task, keys)
    sizes = (worlds.obs_dim, worlds.code_length, worlds.action_dim)
    policy = Policy(num_envs, *sizes, hidden)
    rng = np.random.default_rng(0)
    actor, critic = (_weights((sizes[0], *hidden, outputs), rng) for outputs in (sizes[2], 1))
    policy.assign(actor, critic, np.full(sizes[2], -0.5))
    captured = CapturedStep(worlds, policy, Rollout(horizon, num_envs, sizes[0], sizes[2]), keys)
    worlds.reset()
    return captured


def device_arrays(rollout: Rollout) -> dict[str, wp.array]:
    """Return all buffers of a rollout by name."""
    return {name: array for name, array in vars(rollout).items() if isinstance(array, wp.array)}


def _weights(sizes: Sequence[int], rng: np.random.Generator) -> NDArray[np.float32]:
    """Return flat weights: random matrices, small enough that units do not saturate, and biases of 0."""
    parts = [
        part
        for inputs, outputs in itertools.pairwise(sizes)
        for part in (rng.normal(size=inputs * outputs) / math.sqrt(inputs), np.zeros(outputs))
    ]
    return np.concatenate(parts).astype(np.float32)
