"""rl_zoo3's training command runs as it is installed."""

from __future__ import annotations

from pathlib import Path

import gymnasium
import numpy as np
import pytest

pytest.importorskip("rl_zoo3")

from stable_baselines3 import PPO

from .program import run_program

pytestmark = pytest.mark.interop

SETTINGS = """\
dappo_batch/Ant-v0:
  n_envs: 2
  n_timesteps: 64
  policy: MlpPolicy
  n_steps: 16
  batch_size: 32
  n_epochs: 1
  normalize: true
"""


def test_the_training_command_trains_evaluates_and_saves_a_policy(tmp_path: Path) -> None:
    settings = tmp_path / "ppo.yml"
    settings.write_text(SETTINGS)
    command = ["-m", "rl_zoo3.train", "--algo", "ppo", "--env", "dappo_batch/Ant-v0", "--device", "cpu"]
    command += ["--gym-packages", "dappo_batch", "--conf-file", str(settings), "--log-folder", "logs"]
    command += ["--eval-freq", "32", "--eval-episodes", "2", "--seed", "0"]
    command += ["--env-kwargs", "max_episode_steps:20", "damage:'missing_toe@2'"]
    run_program(command, tmp_path)
    folder = tmp_path / "logs" / "ppo" / "dappo_batch-Ant-v0_1"
    evaluations = np.load(folder / "evaluations.npz")
    assert evaluations["timesteps"].tolist() == [32, 64]
    assert (evaluations["ep_lengths"] <= 20).all()
    policy = PPO.load(folder / "dappo_batch-Ant-v0.zip", device="cpu")
    env = gymnasium.make("dappo_batch/Ant-v0")
    assert policy.observation_space == env.observation_space
    assert policy.action_space == env.action_space
