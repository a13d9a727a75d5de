"""Stable-Baselines3 trains on the single env and on the vector env behind its adaptor."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from gymnasium.wrappers import TimeLimit
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import DummyVecEnv, VecMonitor, VecNormalize

import dappo_batch
from dappo_batch import ClassTable, ConfigError, DamageEnv
from dappo_batch.interop.sb3 import Sb3VecEnv

pytestmark = pytest.mark.interop

NUM_ENVS = 5
STEPS = 90
LIMIT = 14
PPO_OPTIONS: dict[str, Any] = {"n_steps": 16, "batch_size": 16, "n_epochs": 1, "seed": 0, "device": "cpu"}


def adapted(table: ClassTable, num_envs: int = NUM_ENVS, **options: Any) -> Sb3VecEnv:  # noqa: ANN401
    return Sb3VecEnv(dappo_batch.make_vec(table, num_envs, autoreset="same_step", **options))


def parameters(model: PPO) -> np.ndarray:
    return np.concatenate([value.detach().numpy().ravel() for value in model.policy.parameters()])


def test_the_checker_accepts_the_single_env(ant_table: ClassTable) -> None:
    check_env(DamageEnv(ant_table))


def test_ppo_learns_on_the_single_env() -> None:
    model = PPO("MlpPolicy", gymnasium.make("dappo_batch/Ant-v0"), **PPO_OPTIONS)
    before = parameters(model)
    model.learn(64)
    assert model.num_timesteps == 64
    assert np.isfinite(parameters(model)).all()
    assert (parameters(model) != before).any()


def test_ppo_learns_on_the_vector_env_inside_the_wrappers_of_the_library(ant_table: ClassTable) -> None:
    envs = VecNormalize(VecMonitor(adapted(ant_table, 8, max_episode_steps=LIMIT)))
    model = PPO("MlpPolicy", envs, **PPO_OPTIONS)
    before = parameters(model)
    model.learn(256)
    assert model.num_timesteps == 256
    assert np.isfinite(parameters(model)).all()
    assert (parameters(model) != before).any()
    assert {episode["l"] for episode in model.ep_info_buffer} == {LIMIT}
    action, _ = model.predict(envs.reset(), deterministic=True)
    assert action.shape == (8, 8)


def test_transitions_equal_those_of_dummy_vec_env_over_single_envs(
    nervous_tables: dict[str, ClassTable], assert_identical: Callable[..., None]
) -> None:
    table = nervous_tables["ant"]
    ours = adapted(table, onset=(0, 8), max_episode_steps=LIMIT)
    theirs = DummyVecEnv([lambda: TimeLimit(DamageEnv(table, onset=(0, 8)), LIMIT)] * NUM_ENVS)
    assert ours.seed(3) == theirs.seed(3)
    rng = np.random.default_rng(0)
    fell = timed_out = 0
    for reset in range(2):  # with the seeds, then with the continued streams
        assert_identical(ours.reset(), theirs.reset(), f"reset {reset}")
        assert ours.reset_infos == theirs.reset_infos
        for step in range(STEPS):
            actions = rng.uniform(-1.2, 1.2, (NUM_ENVS, 8)).astype(np.float32)
            (*arrays, infos), (*their_arrays, their_infos) = ours.step(actions), theirs.step(actions)
            assert_identical(tuple(arrays), tuple(their_arrays), f"step {step}")
            for info, their_info in zip(infos, their_infos, strict=True):
                assert_identical(info, their_info, f"infos of step {step}")
            assert_identical(ours.reset_infos[0], theirs.reset_infos[0], f"reset infos of step {step}")
            ended = [info for info in infos if "terminal_observation" in info]
            timed_out += sum(info["TimeLimit.truncated"] for info in ended)
            fell += sum(not info["TimeLimit.truncated"] for info in ended)
    assert fell > 10
    assert timed_out > 10


def test_transitions_equal_those_of_the_native_vector_env(ant_table: ClassTable) -> None:
    options = {"seed": 7, "max_episode_steps": LIMIT}
    ours = adapted(ant_table, **options)
    native = dappo_batch.make_vec(ant_table, NUM_ENVS, autoreset="same_step", **options)
    np.testing.assert_array_equal(ours.reset(), native.reset()[0])
    rng = np.random.default_rng(1)
    ends = 0
    for _ in range(3 * LIMIT):
        actions = rng.uniform(-1.0, 1.0, (NUM_ENVS, 8)).astype(np.float32)
        obs, rewards, dones, infos = ours.step(actions)
        expected, their_rewards, terminated, truncated, their_infos = native.step(actions)
        np.testing.assert_array_equal(obs, expected)
        np.testing.assert_array_equal(rewards, their_rewards.astype(np.float32))
        np.testing.assert_array_equal(dones, terminated | truncated)
        ends += dones.sum()
        timed_out = [info["TimeLimit.truncated"] for info in infos]
        np.testing.assert_array_equal(timed_out, truncated & ~terminated)
        for index in np.flatnonzero(dones):
            last = infos[index]["terminal_observation"]
            np.testing.assert_array_equal(last, their_infos["final_obs"][index])
            assert (last != obs[index]).any()
            assert infos[index]["damage_class"] == their_infos["final_info"]["damage_class"][index]
            assert ours.reset_infos[index]["damage_class"] == their_infos["damage_class"][index]
    assert ends >= 3 * NUM_ENVS


def test_options_choose_the_damage_of_the_next_reset_alone(ant_table: ClassTable) -> None:
    envs = adapted(ant_table, 3, damage="healthy")
    envs.set_options([{"damage_class": 2}, {}, {"damage_class": 5, "onset": 4}])
    envs.reset()
    assert [info["damage_class"] for info in envs.reset_infos] == [2, 0, 0]
    assert [info["damage_onset"] for info in envs.reset_infos] == [0, 0, 4]
    envs.reset()
    assert [info["damage_class"] for info in envs.reset_infos] == [0, 0, 0]


def test_attributes_and_states_are_given_for_the_envs_asked_for(ant_table: ClassTable) -> None:
    envs = adapted(ant_table)
    envs.reset()
    assert envs.get_attr("table", indices=[0, 2]) == [ant_table] * 2
    assert not envs.has_attr("action_masks")
    assert envs.env_is_wrapped(TimeLimit) == [False] * NUM_ENVS
    [(qpos, qvel)] = envs.env_method("get_state", indices=3)
    np.testing.assert_array_equal(qpos, envs.envs.get_state()[0][3])
    np.testing.assert_array_equal(qvel, envs.envs.get_state()[1][3])
    with pytest.raises(ConfigError, match="expected 'get_state', got 'reset'"):
        envs.env_method("reset")
    with pytest.raises(ConfigError, match="share all attributes"):
        envs.set_attr("severity", 0.5)


def test_other_autoreset_modes_and_views_are_rejected(ant_table: ClassTable) -> None:
    with pytest.raises(ConfigError, match="autoreset='same_step', got 'next_step'"):
        Sb3VecEnv(dappo_batch.make_vec(ant_table, 2))
    with pytest.raises(ConfigError, match="copy=True"):
        adapted(ant_table, 2, copy=False)
