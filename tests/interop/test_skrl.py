"""skrl's wrapper accepts the vector env, and its PPO trains on it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("skrl")

import torch
from skrl import config
from skrl.agents.torch.ppo import PPO
from skrl.envs.wrappers.torch import wrap_env
from skrl.memories.torch import RandomMemory
from skrl.models.torch import DeterministicMixin, GaussianMixin, Model
from skrl.trainers.torch import SequentialTrainer

import dappo_batch
from dappo_batch import ClassTable

pytestmark = pytest.mark.interop

NUM_ENVS = 4
HORIZON = 8
LIMIT = 5


class Policy(GaussianMixin, Model):
    def __init__(self, **spaces: Any) -> None:  # noqa: ANN401
        Model.__init__(self, **spaces)
        GaussianMixin.__init__(self)
        self.net = torch.nn.Linear(self.num_observations, self.num_actions)
        self.log_std = torch.nn.Parameter(torch.zeros(self.num_actions))

    def compute(self, inputs: dict[str, Any], role: str) -> tuple[torch.Tensor, dict[str, Any]]:
        return self.net(inputs["observations"]), {"log_std": self.log_std}


class Value(DeterministicMixin, Model):
    def __init__(self, **spaces: Any) -> None:  # noqa: ANN401
        Model.__init__(self, **spaces)
        DeterministicMixin.__init__(self)
        self.net = torch.nn.Linear(self.num_observations, 1)

    def compute(self, inputs: dict[str, Any], role: str) -> tuple[torch.Tensor, dict[str, Any]]:
        return self.net(inputs["observations"]), {}


def wrapped(table: ClassTable) -> Any:  # noqa: ANN401
    envs = dappo_batch.make_vec(table, NUM_ENVS, autoreset="same_step", max_episode_steps=LIMIT)
    return wrap_env(envs, verbose=False)


def test_transitions_equal_those_of_the_native_vector_env(ant_table: ClassTable) -> None:
    env = wrapped(ant_table)
    native = dappo_batch.make_vec(ant_table, NUM_ENVS, autoreset="same_step", max_episode_steps=LIMIT)
    assert (env.num_envs, env.observation_space.shape, env.action_space.shape) == (NUM_ENVS, (119,), (8,))
    np.testing.assert_array_equal(env.reset()[0].numpy(), native.reset(seed=config.torch.key)[0])
    rng = np.random.default_rng(0)
    for _ in range(3 * LIMIT):
        actions = rng.uniform(-1.0, 1.0, (NUM_ENVS, 8)).astype(np.float32)
        obs, rewards, terminated, truncated, infos = env.step(torch.from_numpy(actions))
        expected = native.step(actions)
        np.testing.assert_array_equal(obs.numpy(), expected[0])
        np.testing.assert_array_equal(rewards[:, 0].numpy(), expected[1].astype(np.float32))
        np.testing.assert_array_equal(terminated[:, 0].numpy(), expected[2])
        np.testing.assert_array_equal(truncated[:, 0].numpy(), expected[3])
        np.testing.assert_array_equal(infos["damage_class"], expected[4]["damage_class"])


def test_ppo_learns_on_the_vector_env(ant_table: ClassTable, tmp_path: Path) -> None:
    env = wrapped(ant_table)
    spaces = {
        "observation_space": env.observation_space,
        "action_space": env.action_space,
        "device": env.device,
    }
    models = {"policy": Policy(**spaces), "value": Value(**spaces)}
    agent = PPO(
        models=models,
        memory=RandomMemory(memory_size=HORIZON, num_envs=NUM_ENVS, device=env.device),
        cfg={
            "rollouts": HORIZON,
            "learning_epochs": 1,
            "time_limit_bootstrap": True,
            "experiment": {"directory": str(tmp_path), "write_interval": 0, "checkpoint_interval": 0},
        },
        **spaces,
    )
    before = models["policy"].net.weight.detach().clone()
    # `headless`, because skrl asks vector envs for pictures in a way that only Gymnasium's own ones know.
    settings = {
        "timesteps": 2 * HORIZON,
        "headless": True,
        "disable_progressbar": True,
        "close_environment_at_exit": False,
    }
    SequentialTrainer(env=env, agents=agent, cfg=settings).train()
    after = models["policy"].net.weight.detach()
    assert torch.isfinite(after).all()
    assert (after != before).any()
