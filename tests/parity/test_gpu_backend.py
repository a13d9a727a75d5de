"""`device="gpu"` of the vector env compared with the lane engine: the same episodes, and the same tasks."""

from __future__ import annotations

import numpy as np
import pytest

import dappo_batch
from dappo_batch import ClassTable

pytestmark = pytest.mark.usefixtures("gpu")

COUNT = 40


def episodes(table: ClassTable | str, device: str, steps: int, **options: object) -> list[np.ndarray]:
    """Return observations, rewards, ends and velocities of random actions, damage in mid-episode included."""
    envs = dappo_batch.make_vec(table, COUNT, device=device, precision="f64", seed=3, onset=(1, 4), **options)
    assert envs.device == device
    obs, _ = envs.reset()
    rows = [obs]
    rng = np.random.default_rng(5)
    for _ in range(steps):
        actions = rng.uniform(-1, 1, (COUNT, envs.single_action_space.shape[0])).astype(np.float32)
        obs, rewards, terminated, truncated, infos = envs.step(actions)
        rows.append(np.column_stack([obs, rewards, terminated, truncated, infos["forward_velocity"]]))
    envs.close()
    return rows


@pytest.mark.parametrize("robot", ["ant", "hexapod", "go1"])
def test_episodes_are_those_of_the_lane_engine(robot: str) -> None:
    options = {"max_episode_steps": 6, "max_damaged_limbs": 1}
    for got, expected in zip(
        episodes(robot, "gpu", 8, **options), episodes(robot, "cpu", 8, **options), strict=True
    ):
        np.testing.assert_allclose(got, expected, rtol=1e-5, atol=1e-5)


def test_a_snapshot_continues_with_the_same_bits(ant_table: ClassTable) -> None:
    envs = dappo_batch.make_vec(ant_table, COUNT, device="gpu", seed=3)
    envs.reset()
    actions = np.random.default_rng(5).uniform(-1, 1, (6, COUNT, 8)).astype(np.float32)
    for action in actions[:3]:
        envs.step(action)
    saved = envs.save_state()
    expected = [envs.step(action)[:2] for action in actions[3:]]
    envs.restore_state(saved)
    for action, (obs, rewards) in zip(actions[3:], expected, strict=True):
        got = envs.step(action)
        assert np.array_equal(got[0], obs)
        assert np.array_equal(got[1], rewards)
    envs.close()


def test_robots_that_diverge_begin_anew_as_with_the_lane_engine(table: ClassTable) -> None:
    model = table.models[0]
    runs = []
    for device in ("gpu", "cpu"):
        rng = np.random.default_rng(7)
        envs = dappo_batch.make_vec(
            table, COUNT, device=device, precision="f64", seed=1, autoreset="disabled"
        )
        envs.reset()
        rows = []
        for scale in (1e9, 1e20, 1e200):
            qpos = model.qpos0 + scale * rng.normal(size=(COUNT, model.nq))
            envs.reset()
            envs.set_state(qpos, scale * rng.normal(size=(COUNT, model.nv)))
            actions = rng.uniform(-1, 1, (COUNT, model.nu)).astype(np.float32)
            obs, rewards, terminated, *_ = envs.step(actions)
            rows.append(np.column_stack([obs, rewards, terminated]))
        assert envs.diverged == 3 * COUNT
        # Nothing of a state that diverged remains in the next episode.
        envs.reset()
        obs, rewards, terminated, *_ = envs.step(actions)
        rows.append(np.column_stack([obs, rewards, terminated]))
        envs.close()
        runs.append(np.array(rows))
    np.testing.assert_allclose(*runs, rtol=1e-5, atol=1e-5)
