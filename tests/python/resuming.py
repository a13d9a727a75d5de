"""Trainings and episodes that go on from a saved state, as if they had never stopped."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import dappo_batch as db

ITERATION = 128
"""Env steps of an iteration of `trained_twice`."""
_TIMES = {"unix_seconds", "rollout_seconds", "update_seconds"}


def trained_twice(folder: Path, robot: str, iterations: int, **settings: Any) -> db.Run:  # noqa: ANN401
    """Train a robot in one go and in two halves, with equal metrics; `settings` are added to small ones.

    Returns the run of the training in one go.
    """
    options: dict[str, Any] = {"robot": robot, "num_envs": 8, "seed": 3}
    small = {"horizon": 16, "ppo.hidden": [8], "checkpoint.every": 1, "evaluation.episodes": 1}
    # The halves have another budget than the whole.
    options["set"] = small | {"ppo.schedule": "constant"} | settings
    whole = db.train(folder / "whole", total_steps=iterations * ITERATION, **options)
    part = db.train(folder / "part", total_steps=iterations // 2 * ITERATION, **options)
    resumed = db.resume(part.path, total_steps=iterations * ITERATION)
    for column in whole.metrics.keys() - _TIMES:
        np.testing.assert_array_equal(resumed.metrics[column], whole.metrics[column], err_msg=column)
    return whole


def replayed(
    env: db.DamageVectorEnv,
    actions: Iterable[NDArray[Any]],
    read: Callable[[tuple[Any, ...]], list[NDArray[Any]]],
) -> list[list[NDArray[Any]]]:
    """Save the state of envs, step them twice from there, with equal results, and return those.

    `read` returns what is compared of a step, given what `step` returned.
    """
    state, actions = env.save_state(), list(actions)
    runs = []
    for _ in range(2):
        env.restore_state(state)
        runs.append([[array.copy() for array in read(env.step(action))] for action in actions])
    for one, other in zip(*runs, strict=True):
        for first, second in zip(one, other, strict=True):
            np.testing.assert_array_equal(first, second)
    return runs[0]
