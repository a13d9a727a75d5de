"""Rewards and terminations of the kernels compared with NumPy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

from dappo_batch import ClassTable
from dappo_batch.kernels.outcome import Outcome, RewardTerms
from dappo_batch.kernels.task import Task

from .physics import Physics

COUNT = 60


def computed(task: Task, physics: Physics, x_before: NDArray[np.float32]) -> dict[str, NDArray[np.generic]]:
    """Return the outcome that the kernel computes from `physics`; its outputs are NaN or wrong before."""
    count = len(x_before)
    outcome = Outcome(
        x=wp.array(x_before, dtype=wp.float32),
        reward=wp.full(count, np.nan, dtype=wp.float32),
        terminated=wp.array(np.arange(count) % 2 == 0, dtype=wp.bool),
        diverged=wp.array(np.arange(count) % 3 == 0, dtype=wp.bool),
        forward_velocity=wp.full(count, np.nan, dtype=wp.float32),
    )
    RewardTerms(task).compute(physics.on_device(), outcome)
    return {field.name: getattr(outcome, field.name).numpy() for field in dataclasses.fields(Outcome)}


def standing(task: Task, physics: Physics) -> Physics:
    """Give half of the worlds a height at which an episode continues."""
    low, high = task.height
    physics.qpos[::2, 2] = np.linspace(low, high, len(physics.qpos[::2]) + 2)[1:-1]
    return physics


def terms_of(
    task: Task, physics: Physics, velocity: NDArray[np.float64], failed: NDArray[np.bool_]
) -> NDArray:
    """Return the value of every reward term of every world, [K, N], in double precision."""
    force = physics.cfrc_ext.astype(np.float64)
    values = []
    for term in task.reward:
        clip = term.get("clip", np.inf)
        loads = (np.clip(force, -clip, clip) ** 2).sum(2)
        touched = [force[:, list(bodies)].any(axis=(1, 2)) for bodies in task.limb_bodies]
        values.append(
            {
                "forward_velocity": velocity,
                "survive": 1.0 - failed,
                "limb_contacts": np.sum(touched, axis=0),
                "ctrl_squared": (physics.ctrl.astype(np.float64) ** 2).sum(1),
                "contact_forces_squared": loads.sum(1),
                "link_loads_squared": (loads**2).sum(1),
            }[term["term"]]
        )
    return np.array(values)


@pytest.mark.parametrize("name", ["paper", "gym"])
def test_rewards_and_terminations_equal_numpys(table: ClassTable, name: str) -> None:
    if name not in table.robot.spec["reward"]:
        name = "paper"
    rng = np.random.default_rng(0)
    task = Task.of(table, name)
    physics = standing(task, Physics.random(task, COUNT, rng))
    x_before = rng.normal(size=COUNT).astype(np.float32)
    got = computed(task, physics, x_before)

    x_after = physics.xpos[:, task.main_body, 0]
    velocity = (x_after.astype(np.float64) - x_before) / task.dt
    failed = ~((task.height[0] <= physics.qpos[:, 2]) & (physics.qpos[:, 2] <= task.height[1]))
    assert 0 < failed.sum() < COUNT
    terms = terms_of(task, physics, velocity, failed)
    weights = np.array([term["weight"] for term in task.reward])
    np.testing.assert_allclose(got["reward"], weights @ terms, rtol=3e-6, atol=1e-5)
    np.testing.assert_allclose(got["forward_velocity"], velocity, rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(got["terminated"], failed)
    np.testing.assert_array_equal(got["x"], x_after)
    assert not got["diverged"].any()


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 2e10, -2e10])
@pytest.mark.parametrize("field", ["qpos", "qvel", "qacc"])
def test_a_diverged_world_terminates_with_reward_and_velocity_zero(
    ant_table: ClassTable, field: str, value: float
) -> None:
    task = Task.of(ant_table)
    physics = standing(task, Physics.random(task, 8, np.random.default_rng(0)))
    getattr(physics, field)[4, -1] = value
    got = computed(task, physics, np.zeros(8, dtype=np.float32))
    assert np.flatnonzero(got["diverged"]).tolist() == [4]
    assert got["terminated"][4]
    assert got["reward"][4] == got["forward_velocity"][4] == 0.0
    assert np.isfinite(got["reward"]).all()
    assert (np.delete(got["forward_velocity"], 4) != 0.0).all()


def test_the_allowed_range_of_heights_includes_its_limits(ant_table: ClassTable) -> None:
    task = Task.of(ant_table)
    physics = Physics.random(task, 4, np.random.default_rng(0))
    low, high = np.float32(task.height[0]), np.float32(task.height[1])
    physics.qpos[:, 2] = [low, high, np.nextafter(low, np.float32(-1)), np.nextafter(high, np.float32(9))]
    got = computed(task, physics, np.zeros(4, dtype=np.float32))
    assert got["terminated"].tolist() == [False, False, True, True]


def test_an_unknown_term_is_rejected_by_name(ant_table: ClassTable) -> None:
    task = dataclasses.replace(Task.of(ant_table), reward=({"term": "beauty", "weight": 1.0},))
    with pytest.raises(ValueError, match="reward term 'beauty'"):
        RewardTerms(task)
