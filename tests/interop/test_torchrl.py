"""torchrl's wrapper accepts the single env and the vector env."""

from __future__ import annotations

import gymnasium
import numpy as np
import pytest

pytest.importorskip("torchrl")

import torch
from torchrl.envs import GymWrapper
from torchrl.envs.utils import check_env_specs

import dappo_batch
from dappo_batch import ClassTable

pytestmark = pytest.mark.interop

MODES = pytest.mark.parametrize("mode", ["same_step", "disabled"])
NUM_ENVS = 5
LIMIT = 14


def wrapped(table: ClassTable, mode: str) -> GymWrapper:
    return GymWrapper(dappo_batch.make_vec(table, NUM_ENVS, autoreset=mode, max_episode_steps=LIMIT))


def test_the_single_env_passes_the_check_of_its_specs() -> None:
    check_env_specs(GymWrapper(gymnasium.make("dappo_batch/Ant-v0")))


@MODES
def test_the_vector_env_passes_the_check_of_its_specs(ant_table: ClassTable, mode: str) -> None:
    check_env_specs(wrapped(ant_table, mode))


@MODES
def test_a_rollout_equals_the_native_steps_and_keeps_the_last_observations(
    nervous_tables: dict[str, ClassTable], mode: str
) -> None:
    table = nervous_tables["ant"]
    env = wrapped(table, mode)
    env.set_seed(3)  # resets
    torch.manual_seed(0)
    rollout = env.rollout(3 * LIMIT, break_when_any_done=False)
    native = dappo_batch.make_vec(table, NUM_ENVS, autoreset="same_step", max_episode_steps=LIMIT)
    native.reset(seed=3)
    obs, _ = native.reset()
    for step in range(3 * LIMIT):
        np.testing.assert_array_equal(rollout["observation"][:, step].numpy(), obs)
        obs, rewards, terminated, truncated, infos = native.step(rollout["action"][:, step].numpy())
        # Where all envs end in the same step, torchrl resets those of the mode same_step a second time.
        assert not (terminated | truncated).all()
        after = rollout["next"][:, step]
        last = obs.copy()
        for index in np.flatnonzero(terminated | truncated):
            last[index] = infos["final_obs"][index]
        np.testing.assert_array_equal(after["observation"].numpy(), last)
        np.testing.assert_array_equal(after["reward"][:, 0].numpy(), rewards.astype(np.float32))
        np.testing.assert_array_equal(after["terminated"][:, 0].numpy(), terminated)
        np.testing.assert_array_equal(after["truncated"][:, 0].numpy(), truncated)
    assert rollout["next", "terminated"].sum() > 3
    assert rollout["next", "truncated"].sum() > 3
