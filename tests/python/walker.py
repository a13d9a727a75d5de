"""A biped whose task is that of a test."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import dappo_batch as db

BACKENDS = ("lanes", "mujoco")
DT = 0.02
ENVS = 3
SURVIVE = "[rewards]\nsurvive = { weight = 1.0 }\n"

ROBOT = """
name = "walker"
mjcf = "walker.xml"
main_body = "trunk"
task = "task.toml"
limbs = [
  { name = "left", body = "left_thigh", joints = ["left_hip", "left_knee"], foot = "left_foot" },
  { name = "right", body = "right_thigh", joints = ["right_hip", "right_knee"], foot = "right_toe" },
]
damage = { types = ["weak_motor"], max_damaged_limbs = 1, weak_motor = { strength = 0.5 } }
"""

# The feet are a geom and a site, the shanks are turned, and a body without a joint carries the right foot.
MJCF = """
<mujoco>
  <option timestep="0.004" integrator="implicitfast"/>
  <default>
    <geom contype="0" conaffinity="1"/>
    <position kp="20" kv="0.5" ctrlrange="-2 2" forcerange="-8 8"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="9 9 1" contype="1" conaffinity="0"/>
    <body name="trunk" pos="0 0 0.4">
      <freejoint/>
      <geom type="box" size="0.15 0.1 0.03" mass="2"/>
      <body name="left_thigh" pos="0 0.12 0">
        <joint name="left_hip" axis="0 1 0" range="-1 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.5"/>
        <body name="left_shank" pos="0 0 -0.2" euler="0 20 0">
          <joint name="left_knee" axis="0 1 0" range="-1.5 1" pos="0.01 0 0"/>
          <geom name="left_foot" type="sphere" pos="0.01 0 -0.18" size="0.03" mass="0.2"/>
        </body>
      </body>
      <body name="right_thigh" pos="0 -0.12 0">
        <joint name="right_hip" axis="0 1 0" range="-1 1"/>
        <geom type="capsule" fromto="0 0 0 0 0 -0.2" size="0.02" mass="0.5"/>
        <body name="right_shank" pos="0 0 -0.2" euler="0 10 5">
          <joint name="right_knee" axis="0 1 0" range="-1.5 1"/>
          <geom type="capsule" fromto="0 0 0 0 0 -0.1" size="0.01" mass="0.1"/>
          <body name="right_end" pos="0 0 -0.15" euler="0 -15 0">
            <geom type="sphere" size="0.03" mass="0.1"/>
            <site name="right_toe" pos="0.01 0.005 -0.02"/>
          </body>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator>
    <position joint="right_knee"/>
    <position name="right_hip" joint="right_hip"/>
    <position name="left_hip" joint="left_hip"/>
    <position name="left_knee" joint="left_knee"/>
  </actuator>
  <keyframe>
    <key name="home" qpos="0 0 0.36 1 0 0 0 0.3 -0.8 -0.2 -0.5"/>
  </keyframe>
</mujoco>
"""

TASK = """
frame_skip = 5
max_episode_steps = 500
commands.velocity.lin_vel_x = [-1.0, 1.0]
commands.velocity.lin_vel_y = [-0.5, 0.5]
commands.velocity.ang_vel_z = [-1.0, 1.0]
commands.velocity.standing = 0.2
commands.velocity.resample_every = [0.1, 0.3]
actions = { type = "joint_position", scale = { ".*hip" = 0.5, "left_knee|actuator 0" = 0.25 } }
reset = { keyframe = "home", qpos_noise = 0.05, qvel_noise = 0.3 }
"""


def make_walker(folder: Path, task: str, backend: str, **options: Any) -> db.DamageVectorEnv:  # noqa: ANN401
    """Write the files of the robot with a task, and make a vector env of it."""
    (folder / "walker.xml").write_text(MJCF)
    (folder / "walker.toml").write_text(ROBOT)
    (folder / "task.toml").write_text(TASK + task)
    options = {"num_envs": ENVS, "precision": "f64", "seed": 5, "observe_damage": False} | options
    env = db.make_vec(folder / "walker.toml", backend=backend, **options)
    assert env.backend == backend
    return env


def observed(terms: str) -> str:
    """Return the section of a task whose policy observes these terms."""
    return f"[observation.policy]\nterms = [{terms}]\n"
