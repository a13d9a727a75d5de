"""The native vector env does exactly what Gymnasium's own vector env does with single envs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import dappo_batch
from dappo_batch import ClassTable, DamageEnv

NUM_ENVS = 6
STEPS = 90
OPTIONS: dict[str, Any] = {"onset": (0, 8), "max_episode_steps": 14}

MODES = pytest.mark.parametrize("mode", list(AutoresetMode), ids=lambda mode: mode.name.lower())
ROBOTS = pytest.mark.parametrize("robot", ["ant", "hexapod"])


def single_envs(table: ClassTable, mode: AutoresetMode, backend: str = "auto") -> SyncVectorEnv:
    def make() -> DamageEnv:
        return DamageEnv(table, backend=backend, **OPTIONS)

    makers: list[Callable[[], gymnasium.Env]] = [make] * NUM_ENVS
    return SyncVectorEnv(makers, autoreset_mode=mode)


@MODES
@ROBOTS
def test_the_native_env_equals_a_sync_vector_env_of_single_envs_bit_for_bit(
    assert_identical: Callable[..., None],
    nervous_tables: dict[str, ClassTable],
    robot: str,
    mode: AutoresetMode,
    backend: str,
) -> None:
    table = nervous_tables[robot]
    native = dappo_batch.make_vec(table, NUM_ENVS, autoreset=mode, backend=backend, **OPTIONS)
    reference = single_envs(table, mode, backend)
    assert native.metadata == reference.metadata
    rng = np.random.default_rng(1)
    terminations = truncations = 0
    for episode_seed in (11, None):  # a seeded reset, then one in the midst of episodes
        assert_identical(native.reset(seed=episode_seed), reference.reset(seed=episode_seed), "reset")
        for step in range(STEPS):
            actions = rng.uniform(-1.2, 1.2, native.action_space.shape).astype(np.float32)
            returned = native.step(actions)
            assert_identical(returned, reference.step(actions), f"step {step}")
            _, _, terminated, truncated, _ = returned
            terminations += terminated.sum()
            truncations += truncated.sum()
            ended = terminated | truncated
            if mode == AutoresetMode.DISABLED and ended.any():
                masked = native.reset(options={"reset_mask": ended})
                assert_identical(masked, reference.reset(options={"reset_mask": ended}), "masked reset")
    assert terminations > 10
    assert truncations > 10


@MODES
def test_resetting_chosen_envs_in_mid_episode_equals_a_sync_vector_env(
    assert_identical: Callable[..., None], ant_table: ClassTable, mode: AutoresetMode, backend: str
) -> None:
    native = dappo_batch.make_vec(ant_table, NUM_ENVS, autoreset=mode, backend=backend, **OPTIONS)
    reference = single_envs(ant_table, mode, backend)
    assert_identical(native.reset(seed=5), reference.reset(seed=5))
    rng = np.random.default_rng(2)
    for step in range(1, 40):
        actions = rng.uniform(-1.0, 1.0, native.action_space.shape).astype(np.float32)
        returned = native.step(actions)
        assert_identical(returned, reference.step(actions), f"step {step}")
        mask = rng.random(NUM_ENVS) < 0.2
        if mode == AutoresetMode.DISABLED:
            mask |= returned[2] | returned[3]
        if mask.any():
            seed = None if step % 2 else 100 + step
            options = {"reset_mask": mask, "damage_class": "missing_toe@1", "onset": 3}
            masked = native.reset(seed=seed, options=options)
            assert_identical(masked, reference.reset(seed=seed, options=options.copy()), f"reset {step}")


@MODES
def test_the_registered_id_gives_the_same_native_and_as_wrapped_single_envs(
    assert_identical: Callable[..., None], mode: AutoresetMode
) -> None:
    options = {"num_envs": 2, "damage": [1, "healthy"], "reward": "gym", "max_episode_steps": 7}
    native = gymnasium.make_vec("dappo_batch/Ant-v0", autoreset=mode, **options)
    wrapped = gymnasium.make_vec(
        "dappo_batch/Ant-v0", vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **options
    )
    assert isinstance(native, dappo_batch.DamageVectorEnv)
    assert_identical(native.reset(seed=8), wrapped.reset(seed=8))
    native.action_space.seed(0)
    for _ in range(20):
        actions = native.action_space.sample()
        returned = native.step(actions)
        assert_identical(returned, wrapped.step(actions))
        ended = returned[2] | returned[3]
        if mode == AutoresetMode.DISABLED and ended.any():
            assert_identical(
                native.reset(options={"reset_mask": ended}), wrapped.reset(options={"reset_mask": ended})
            )
    native.close()
    wrapped.close()


def test_the_three_modes_differ_only_in_when_the_next_episode_begins(ant_table: ClassTable) -> None:
    actions = np.zeros((3, 8), dtype=np.float32)
    first_observations = []
    for mode in AutoresetMode:
        envs = dappo_batch.make_vec(ant_table, 3, autoreset=mode, max_episode_steps=2, damage="healthy")
        envs.reset(seed=4)
        envs.step(actions)
        obs, _, _, truncated, _ = envs.step(actions)
        assert truncated.all()
        if mode == AutoresetMode.NEXT_STEP:
            obs = envs.step(actions)[0]
        elif mode == AutoresetMode.DISABLED:
            obs = envs.reset(options={"reset_mask": truncated})[0]
        first_observations.append(obs)
    np.testing.assert_array_equal(first_observations[0], first_observations[1])
    np.testing.assert_array_equal(first_observations[0], first_observations[2])


def test_final_observations_survive_the_reset_and_later_steps(ant_table: ClassTable) -> None:
    envs = dappo_batch.make_vec(
        ant_table, 2, autoreset="same_step", max_episode_steps=3, damage="healthy", seed=0
    )
    twin = dappo_batch.make_vec(
        ant_table, 2, autoreset="disabled", max_episode_steps=3, damage="healthy", seed=0
    )
    envs.reset()
    twin.reset()
    rng = np.random.default_rng(0)
    for _ in range(3):
        actions = rng.uniform(-1, 1, (2, 8)).astype(np.float32)
        obs, _, _, truncated, infos = envs.step(actions)
        last, _, _, _, last_infos = twin.step(actions)
    assert truncated.all()
    final = np.stack(list(infos["final_obs"]))
    envs.step(actions)
    np.testing.assert_array_equal(final, last)
    np.testing.assert_array_equal(np.stack(list(infos["final_obs"])), last)
    assert not np.array_equal(obs, last)
    np.testing.assert_array_equal(infos["final_info"]["forward_velocity"], last_infos["forward_velocity"])
    np.testing.assert_array_equal(infos["forward_velocity"], [0.0, 0.0])


def test_without_autoreset_an_ended_episode_must_be_reset_before_the_next_step(ant_table: ClassTable) -> None:
    envs = dappo_batch.make_vec(ant_table, 3, autoreset="disabled", max_episode_steps=1, seed=0)
    envs.reset()
    actions = np.zeros((3, 8), dtype=np.float32)
    envs.step(actions)
    with pytest.raises(ResetNeeded, match="3 envs have ended, the first is env 0"):
        envs.step(actions)
    envs.reset(options={"reset_mask": np.array([True, True, False])})
    with pytest.raises(ResetNeeded, match="1 envs have ended, the first is env 2"):
        envs.step(actions)
    envs.reset()
    envs.step(actions)
