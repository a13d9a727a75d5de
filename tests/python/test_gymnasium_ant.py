"""The healthy Ant is Gymnasium's Ant-v5, and the single env is a proper Gymnasium env."""

from __future__ import annotations

import gymnasium
import mujoco
import numpy as np
import pytest
from gymnasium.error import ResetNeeded
from gymnasium.utils.env_checker import check_env

import dappo_batch
from dappo_batch import ClassTable, ConfigError, DamageEnv, ShapeError, SimulationError

WORLD_FORCES = slice(27, 33)  # after qpos[2:] (13) and qvel (14); Ant-v5 leaves the world body out


def same_start(seed: int, upward_velocity: float = 0.0) -> tuple[gymnasium.Env, gymnasium.Env]:
    """Return our healthy Ant and Ant-v5 in the same state."""
    ours = gymnasium.make(
        "dappo_batch/Ant-v0", damage="healthy", reward="gym", observe_damage=False, backend="mujoco"
    )
    theirs = gymnasium.make("Ant-v5")
    ours.reset(seed=seed)
    theirs.reset(seed=seed)
    qpos, qvel = ours.unwrapped.get_state()
    if upward_velocity:
        qvel[2] = upward_velocity
        ours.unwrapped.set_state(qpos, qvel)
    base = theirs.unwrapped
    mujoco.mj_resetData(base.model, base.data)  # no warm start left over from Ant-v5's own start state
    base.set_state(qpos, qvel)
    return ours, theirs


def follow(ours: gymnasium.Env, theirs: gymnasium.Env, seed: int) -> tuple[int, bool, bool]:
    """Drive both with the same actions to the end of the episode, comparing every step."""
    rng = np.random.default_rng(seed)
    for step in range(1, 1002):
        action = rng.uniform(-1.0, 1.0, 8).astype(np.float32)
        obs, reward, terminated, truncated, info = ours.step(action)
        # In float64, as Ant-v5 sums the squares of an action in the type it is given.
        their_obs, their_reward, their_terminated, their_truncated, their_info = theirs.step(
            action.astype(np.float64)
        )
        qpos, qvel = ours.unwrapped.get_state()
        data = theirs.unwrapped.data
        np.testing.assert_allclose(qpos, data.qpos, rtol=0.0, atol=1e-10, err_msg=f"step {step}")
        np.testing.assert_allclose(qvel, data.qvel, rtol=0.0, atol=1e-10, err_msg=f"step {step}")
        np.testing.assert_allclose(reward, their_reward, rtol=1e-6, atol=1e-9, err_msg=f"step {step}")
        np.testing.assert_allclose(info["forward_velocity"], their_info["x_velocity"], rtol=0.0, atol=1e-9)
        assert obs.dtype == np.float32
        assert not obs[WORLD_FORCES].any()
        np.testing.assert_allclose(
            np.delete(obs, WORLD_FORCES), their_obs, rtol=1e-6, atol=1e-7, err_msg=f"step {step}"
        )
        assert (terminated, truncated) == (their_terminated, their_truncated), f"step {step}"
        if terminated or truncated:
            return step, terminated, truncated
    raise AssertionError("the episode has no end")


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_the_healthy_ant_equals_gymnasiums_ant_v5_to_the_end_of_the_episode(seed: int) -> None:
    ours, theirs = same_start(seed)
    steps, terminated, truncated = follow(ours, theirs, seed)
    assert terminated or (truncated and steps == 1000)


def test_the_healthy_ant_terminates_in_the_same_step_as_ant_v5_when_thrown_upwards() -> None:
    steps, terminated, _ = follow(*same_start(3, upward_velocity=4.0), seed=3)
    assert terminated
    assert steps < 20


def test_the_first_observation_equals_that_of_ant_v5() -> None:
    ours, theirs = same_start(7)
    obs, _ = ours.reset(seed=7)
    np.testing.assert_allclose(
        np.delete(obs, WORLD_FORCES)[:27], theirs.unwrapped._get_obs()[:27], rtol=1e-6, atol=1e-7
    )
    assert not obs[27:].any()  # contact forces are zero until the first step, as in Ant-v5


@pytest.mark.parametrize("robot", ["Ant", "Hexapod"])
@pytest.mark.filterwarnings("ignore:.*A Box observation space:UserWarning")
def test_the_registered_envs_pass_gymnasiums_checker(robot: str) -> None:
    env = gymnasium.make(f"dappo_batch/{robot}-v0")
    check_env(env.unwrapped, skip_render_check=True)
    env.close()


def test_importing_and_registering_again_changes_nothing() -> None:
    before = gymnasium.spec("dappo_batch/Ant-v0")
    dappo_batch.register_envs()  # a second registration would warn, and warnings are errors here
    assert gymnasium.spec("dappo_batch/Ant-v0") is before
    assert before.max_episode_steps == 1000


def test_the_time_limit_of_make_is_the_only_one() -> None:
    env = gymnasium.make("dappo_batch/Hexapod-v0", damage="healthy", max_episode_steps=1003)
    env.reset(seed=0)
    action = np.zeros(18, dtype=np.float32)
    ends = [env.step(action)[2:4] for _ in range(1003)]
    assert ends == [(False, False)] * 1002 + [(False, True)]


def test_a_single_env_returns_python_numbers_and_the_chosen_classes(ant_table: ClassTable) -> None:
    env = DamageEnv(ant_table, damage="uniform")
    obs, info = env.reset(seed=0, options={"damage_class": "jammed_joint@2"})
    assert obs.shape == (119,)
    assert info == {
        "damage_class": ant_table.space.parse("jammed_joint@2"),
        "damage_onset": 0,
        "severity": 1.0,
        "forward_velocity": 0.0,
    }
    _, reward, terminated, truncated, info = env.step(np.zeros(8))
    assert [type(value) for value in (reward, terminated, truncated)] == [float, bool, bool]
    assert [type(info[key]) for key in sorted(info)] == [int, int, float, float]


def test_a_single_env_refuses_what_it_cannot_use_with_typed_errors(ant_table: ClassTable) -> None:
    env = DamageEnv(ant_table)
    with pytest.raises(ResetNeeded):
        env.step(np.zeros(8))
    env.reset(seed=0)
    with pytest.raises(ShapeError, match=r"expected shape \(8,\), got \(7,\)"):
        env.step(np.zeros(7))
    with pytest.raises(ConfigError):
        env.step(np.full(8, np.nan))
    with pytest.raises(ConfigError):
        env.reset(seed=-1)
    with pytest.raises(ConfigError, match="render_mode"):
        DamageEnv(ant_table, render_mode="human")
    env.close()
    env.close()
    with pytest.raises(SimulationError, match="closed"):
        env.step(np.zeros(8))
    with pytest.raises(SimulationError, match="closed"):
        env.reset()
