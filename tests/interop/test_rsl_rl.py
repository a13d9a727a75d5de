"""rsl_rl trains on the vector env behind its adaptor."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("rsl_rl")

import torch
from rsl_rl.runners import OnPolicyRunner

import dappo_batch
from dappo_batch import ClassTable, ConfigError
from dappo_batch.interop.rsl_rl import RslRlVecEnv

pytestmark = pytest.mark.interop

NUM_ENVS = 4
HORIZON = 8
ALL = ["robot", "damage_code"]


def adapted(table: ClassTable, **options: Any) -> RslRlVecEnv:  # noqa: ANN401
    return RslRlVecEnv(dappo_batch.make_vec(table, NUM_ENVS, autoreset="disabled", **options))


def settings(actor: list[str], critic: list[str]) -> dict[str, Any]:
    network = {"class_name": "MLPModel", "hidden_dims": [16], "obs_normalization": True}
    noise = {"class_name": "GaussianDistribution", "init_std": 1.0}
    return {
        "num_steps_per_env": HORIZON,
        "save_interval": 100,
        "obs_groups": {"actor": actor, "critic": critic},
        "actor": network | {"distribution_cfg": noise},
        "critic": dict(network),
        "algorithm": {"class_name": "PPO", "num_learning_epochs": 1, "num_mini_batches": 2},
    }


def joined(groups: Any) -> np.ndarray:  # noqa: ANN401
    return torch.cat([groups[name] for name in ALL], dim=1).numpy()


@pytest.mark.parametrize(("actor", "inputs"), [(ALL, 119), (["robot"], 111)], ids=["aware", "unaware"])
def test_the_runner_learns_with_and_without_the_damage_code_in_the_policy(
    ant_table: ClassTable, tmp_path: Path, actor: list[str], inputs: int
) -> None:
    envs = adapted(ant_table, max_episode_steps=5)
    runner = OnPolicyRunner(envs, settings(actor, ALL), log_dir=str(tmp_path), device="cpu")
    policy = runner.alg.actor
    before = [value.detach().clone() for value in policy.parameters()]
    runner.learn(2, init_at_random_ep_len=True)
    assert policy.obs_dim == inputs
    assert all(torch.isfinite(value).all() for value in policy.parameters())
    assert any((new != old).any() for new, old in zip(policy.parameters(), before, strict=True))
    assert runner.logger.tot_timesteps == 2 * HORIZON * NUM_ENVS
    assert max(runner.logger.lenbuffer) == 5
    assert (tmp_path / "model_1.pt").is_file()


def test_transitions_equal_those_of_the_native_vector_env(nervous_tables: dict[str, ClassTable]) -> None:
    table, options = nervous_tables["ant"], {"seed": 4, "max_episode_steps": 14}
    ours = adapted(table, **options)
    native = dappo_batch.make_vec(table, NUM_ENVS, autoreset="same_step", **options)
    assert (ours.num_envs, ours.num_actions, ours.max_episode_length) == (NUM_ENVS, 8, 14)
    np.testing.assert_array_equal(joined(ours.get_observations()), native.reset()[0])
    rng = np.random.default_rng(1)
    fell = timed_out = 0
    steps = np.zeros(NUM_ENVS, dtype=np.int64)
    for _ in range(90):
        actions = rng.uniform(-1.2, 1.2, (NUM_ENVS, 8)).astype(np.float32)
        groups, rewards, dones, extras = ours.step(torch.from_numpy(actions))
        obs, their_rewards, terminated, truncated, _ = native.step(actions)
        np.testing.assert_array_equal(joined(groups), obs)
        assert groups is ours.get_observations()
        np.testing.assert_array_equal(rewards.numpy(), their_rewards.astype(np.float32))
        np.testing.assert_array_equal(dones.numpy(), terminated | truncated)
        np.testing.assert_array_equal(extras["time_outs"].numpy(), truncated & ~terminated)
        steps = np.where(terminated | truncated, 0, steps + 1)
        np.testing.assert_array_equal(ours.episode_length_buf.numpy(), steps)
        fell += terminated.sum()
        timed_out += (truncated & ~terminated).sum()
    assert fell > 10
    assert timed_out > 10


def test_an_episode_that_the_runner_shortens_times_out_earlier(ant_table: ClassTable) -> None:
    envs = adapted(ant_table, max_episode_steps=6)
    envs.episode_length_buf = torch.tensor([5, 0, 4, 0])
    ends = []
    for _ in range(6):
        _, _, dones, extras = envs.step(torch.zeros(NUM_ENVS, 8))
        assert (dones == extras["time_outs"]).all()
        ends.append(dones.int().tolist())
    assert ends == [[1, 0, 0, 0], [0, 0, 1, 0], [0] * 4, [0] * 4, [0] * 4, [0, 1, 0, 1]]


def test_an_env_that_hides_the_damage_has_no_group_for_its_code(ant_table: ClassTable) -> None:
    envs = adapted(ant_table, observe_damage=False)
    assert {name: rows.shape for name, rows in envs.get_observations().items()} == {"robot": (NUM_ENVS, 111)}


def test_other_autoreset_modes_are_rejected(ant_table: ClassTable) -> None:
    with pytest.raises(ConfigError, match="autoreset='disabled', got 'same_step'"):
        RslRlVecEnv(dappo_batch.make_vec(ant_table, 2, autoreset="same_step"))
