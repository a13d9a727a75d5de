"""Rollouts in the kernels of `device="gpu"` compared with those of the lane engine and the host's tasks."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dappo_batch
from dappo_batch._core import collect_rollout

from ..python.burnpack import checkpoint_contents
from ..python.command_line import dappo_batch as command_line
from ..python.command_line import metrics

pytestmark = pytest.mark.usefixtures("gpu")

ROBOTS = Path(dappo_batch.__file__).parent / "robots"
ENVS = 24


def rollouts(
    robot: str, settings: dict[str, Any], precision: str = "f64"
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Collect the first rollout of a training on the CPU and on the GPU."""
    options: dict[str, Any] = {"num_envs": ENVS, "seed": 5, "robot": robot, "precision": precision}
    options["set"] = settings
    host = collect_rollout(device="cpu", backend="lanes", **options)
    return host, collect_rollout(device="gpu", **options)


def compare(host: dict[str, Any], gpu: dict[str, Any], tolerance: float) -> None:
    """Compare everything that the learner sees."""
    assert list(gpu) == list(host)
    for name, expected in host.items():
        assert (gpu[name].shape, gpu[name].dtype) == (expected.shape, expected.dtype), name
        np.testing.assert_allclose(gpu[name], expected, rtol=tolerance, atol=tolerance, err_msg=name)


@pytest.mark.parametrize("robot", ["ant", "hexapod", "go1"])
def test_rollouts_are_those_of_the_host(robot: str) -> None:
    """In a rollout, damage strikes and episodes of three steps are followed by others."""
    settings = {
        "horizon": 8,
        "ppo.hidden": [16, 8],
        "env.max_episode_steps": 3,
        "damage.max_damaged_limbs": 1,
        "damage.onset": {"first": 0, "last": 2},
        "curriculum": [{"name": "all", "mix": "uniform"}],
        "damage.code_delay": {"first": 0, "last": 1},
    }
    host, gpu = rollouts(robot, settings)
    np.testing.assert_array_equal(gpu["start_episodes"], host["start_episodes"])
    np.testing.assert_array_equal(gpu["truncated"], host["truncated"])
    assert host["truncated"].sum() == 2 * ENVS
    assert (host["final_values"] != 0.0).any()
    code = host["obs"][:, :, -8:]
    assert len({tuple(row) for row in code.reshape(-1, 8)}) > 4
    compare(host, gpu, 1e-5)


EVERYTHING = """
[tasks.velocity.commands.velocity]
resample_every = [0.02, 0.06]
standing = 0.4

[tasks.velocity.curriculum.commands]
start = 0.2
steps = 5

[tasks.velocity.observation.policy]
terms = [
  { term = "qpos", skip = 0 },
  { term = "qvel", clip = 2.0 },
  { term = "cfrc_ext", clip = 30.0, scale = 0.1 },
  { term = "touch" },
  { term = "base_height", delay = 1 },
  { term = "base_lin_vel", noise = 0.1, history = 3 },
  { term = "base_ang_vel", noise = 0.2, scale = 0.25, delay = 1, history = 2 },
  { term = "projected_gravity", noise = 0.05 },
  { term = "command" },
  { term = "joint_pos", noise = 0.01 },
  { term = "joint_vel", noise = 1.5, scale = 0.05 },
  { term = "last_action" },
  { term = "clock", period = 0.7 },
]

[tasks.velocity.observation.critic]
terms = [
  { term = "foot_contact" },
  { term = "foot_vel", noise = 0.1 },
  { term = "foot_height", history = 2 },
  { term = "foot_air_time" },
  { term = "events" },
]

[tasks.velocity.rewards]
forward_velocity = { weight = 0.3 }
survive = { weight = 0.2 }
limb_contacts = { weight = -0.1 }
ctrl_squared = { weight = -0.01 }
contact_forces_squared = { weight = -1e-3, clip = 5.0 }
link_loads_squared = { weight = -1e-4, clip = 2.0 }
upright = { weight = 0.4, std = 0.3 }
base_height_squared = { weight = -1.0, target = 0.3 }
power = { weight = -1e-3 }
joint_limits = { weight = -0.5, soft = 0.2 }
pose = { weight = 0.2, std = 0.4 }
stand_still = { weight = -0.3 }
feet_clearance = { weight = -0.5, target = 0.06 }
landing = { weight = -1e-3 }

[tasks.velocity.terminations]
height = [0.1, 0.6]
tilt = { angle = 0.14 }
contact = { bodies = ["FR_calf", "RL_hip"], force = 400.0 }

[tasks.velocity.events]
friction = { scale = [0.6, 1.4] }
motor_strength = { scale = [0.9, 1.1] }
kp = { scale = [0.8, 1.2] }
kd = { scale = [0.7, 1.3] }
joint_damping = { scale = [0.5, 1.5] }
joint_armature = { scale = [0.8, 1.2] }
encoder_bias = { offset = [-0.05, 0.05] }
action_delay = { steps = [0, 2] }
gravity = { angle = [0.0, 0.1] }
push = { every = [0.02, 0.06], lin_vel = 1.5, ang_vel = 1.0 }
mass = { bodies = "trunk", scale = [0.8, 1.2] }
variants = 3
"""
"""Every term and event of the velocity task that the robot's own task does not have already."""


def robot_with_everything(folder: Path) -> Path:
    text = (ROBOTS / "go1.toml").read_text()
    text = text.replace('"go1.xml"', f'"{ROBOTS / "go1.xml"}"').replace('name = "go1"', 'name = "everything"')
    # Its joints jam where they are when the damage strikes.
    text = text.replace('at = "default"', 'at = "current"')
    path = folder / "everything.toml"
    path.write_text(text + EVERYTHING)
    return path


def test_every_term_and_event_is_that_of_the_host(tmp_path: Path) -> None:
    settings = {
        "horizon": 7,
        "ppo.hidden": [16],
        "env.max_episode_steps": 5,
        "damage.max_damaged_limbs": 1,
        "damage.onset": {"first": 0, "last": 2},
        "damage.duration": {"first": 1, "last": 2},
        "damage.pause": {"first": 1, "last": 2},
        "damage.min_class_steps": 6,
    }
    path = robot_with_everything(tmp_path)
    host, gpu = rollouts(str(path), settings)
    assert host["terminated"].any()
    assert host["truncated"].any()
    compare(host, gpu, 2e-5)


def test_rollouts_in_single_precision_stay_close() -> None:
    settings = {"horizon": 4, "ppo.hidden": [16], "env.max_episode_steps": 2}
    host, gpu = rollouts("ant", settings, "f32")
    np.testing.assert_array_equal(gpu["start_episodes"], host["start_episodes"])
    np.testing.assert_array_equal(gpu["truncated"], host["truncated"])
    compare(host, gpu, 2e-3)


def test_the_same_device_computes_the_same_bits_every_time() -> None:
    options: dict[str, Any] = {"robot": "go1", "num_envs": ENVS, "seed": 5, "device": "gpu"}
    settings = {"horizon": 6, "ppo.hidden": [16], "env.max_episode_steps": 4}
    one, other = (collect_rollout(set=settings, **options) for _ in range(2))
    for name, array in one.items():
        np.testing.assert_array_equal(other[name], array, err_msg=name)


def test_a_training_that_is_resumed_computes_the_same_bits(tmp_path: Path) -> None:
    """With envs that have constants of their own, and one checkpoint in the middle of episodes."""
    settings = {
        "horizon": 5,
        "ppo.hidden": [16],
        "env.max_episode_steps": 7,
        "damage.onset": {"first": 0, "last": 5},
        "evaluation.episodes": 1,
        "damage.max_damaged_limbs": 1,
    }
    options: dict[str, Any] = {"robot": "go1", "num_envs": 8, "seed": 3, "device": "gpu", "set": settings}
    whole = dappo_batch.train(tmp_path / "whole", total_steps=3 * 40, **options)
    half = dappo_batch.train(tmp_path / "half", total_steps=40, **options)
    resumed = dappo_batch.resume(half.path, total_steps=3 * 40)
    assert metrics(resumed.path) == metrics(whole.path)
    newest = [max((run.path / "checkpoints").glob("0*")) for run in (resumed, whole)]
    assert checkpoint_contents(newest[0]) == checkpoint_contents(newest[1])


def test_what_the_kernels_do_not_know_is_computed_on_the_cpu(tmp_path: Path) -> None:
    """The training says so, and its rollouts are those of the CPU."""
    text = robot_with_everything(tmp_path).read_text()
    path = tmp_path / "dropouts.toml"
    path.write_text(text + "action_dropout = { share = 0.7, every = [0.04, 0.2], duration = [0.02, 0.1] }\n")
    settings = {"horizon": 2, "ppo.hidden": [8], "damage.max_damaged_limbs": 1}
    host, gpu = rollouts(str(path), settings)
    compare(host, gpu, 1e-5)
    run = tmp_path / "run"
    sets = [f"{key}={value}" for key, value in settings.items()]
    arguments = ["--robot", path, "--envs", "2", "--steps", "4", "--device", "gpu", "--set", *sets]
    out, err = command_line("train", "--run", run, *arguments, "evaluation.episodes=1")
    assert "the kernels do not know actions that do not arrive" in out + err
