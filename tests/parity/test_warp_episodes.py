"""Whole episodes of the kernels compared with the `mujoco` backend: draws, onset, time limit, autoreset."""

from __future__ import annotations

import numpy as np
import pytest

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

import mujoco

import dappo_batch
from dappo_batch import ClassTable
from dappo_batch.kernels.task import Task
from dappo_batch.kernels.worlds import Worlds

from .states import with_cone

COUNT, STEPS, LIMIT, SEED = 12, 8, 3, 21


def test_episodes_run_as_with_the_mujoco_backend(table: ClassTable) -> None:
    """With elliptic cones, as the physics would differ from the first contact on otherwise."""
    table = with_cone(table, mujoco.mjtCone.mjCONE_ELLIPTIC)
    onset = (0, LIMIT - 1)
    envs = dappo_batch.make_vec(
        table,
        COUNT,
        backend="mujoco",
        seed=SEED,
        autoreset="same_step",
        onset=onset,
        max_episode_steps=LIMIT,
    )
    worlds = Worlds(Task.of(table), np.arange(SEED, SEED + COUNT, dtype=np.uint64), max_episode_steps=LIMIT)
    worlds.draws.onset_range.assign(np.array(onset, dtype=np.int32))
    obs, _ = envs.reset()
    worlds.reset()
    rng = np.random.default_rng(5)
    activated = 0
    for _ in range(STEPS):
        np.testing.assert_allclose(worlds.obs.numpy(), obs, rtol=1e-3, atol=1e-3)
        before = worlds.episodes.damage_class.numpy().copy()
        actions = rng.uniform(-1, 1, (COUNT, worlds.action_dim)).astype(np.float32)
        obs, rewards, terminated, truncated, infos = envs.step(actions)
        worlds.step(wp.array(actions))
        outcome, ends = worlds.outcome, worlds.episode_ends
        np.testing.assert_array_equal(outcome.terminated.numpy(), terminated)
        np.testing.assert_array_equal(ends.truncated.numpy(), truncated)
        np.testing.assert_allclose(outcome.reward.numpy(), rewards, rtol=1e-3, atol=1e-3)
        np.testing.assert_array_equal(worlds.episodes.damage_class.numpy(), infos["damage_class"])
        np.testing.assert_array_equal(worlds.episodes.onset.numpy(), infos["damage_onset"])
        activated += int((ends.damage_class.numpy() != before).sum())
        if "final_obs" not in infos:
            continue
        ended, final = infos["_final_obs"], infos["final_info"]
        np.testing.assert_array_equal(ends.ended.numpy(), ended)
        expected = np.stack(infos["final_obs"][ended])
        np.testing.assert_allclose(ends.final_obs.numpy()[ended], expected, rtol=1e-3, atol=1e-3)
        np.testing.assert_array_equal(ends.damage_class.numpy()[ended], final["damage_class"][ended])
        np.testing.assert_array_equal(ends.onset.numpy()[ended], final["damage_onset"][ended])
        np.testing.assert_allclose(
            outcome.forward_velocity.numpy()[ended], final["forward_velocity"][ended], rtol=1e-3, atol=1e-3
        )
    envs.close()
    assert activated > 5
    assert (worlds.episodes.number.numpy() == STEPS // LIMIT).any()
