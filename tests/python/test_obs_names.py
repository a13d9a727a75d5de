"""Names and units of the entries of an observation, against the state that MuJoCo's addresses give."""

from __future__ import annotations

import contextlib
import tomllib
from pathlib import Path

import numpy as np
import pytest

import dappo_batch as db

from .walker import make_walker, observed

ROBOTS = ("ant", "hexapod", "go1", "go2")


@pytest.mark.parametrize("robot", ROBOTS)
def test_every_entry_has_a_name_of_its_own_and_a_unit(robot: str) -> None:
    with contextlib.closing(db.make_vec(robot, 1, max_damaged_limbs=1)) as env:
        assert len(env.obs_names) == len(env.obs_units) == env.single_observation_space.shape[0]
        assert len(set(env.obs_names)) == len(env.obs_names)
        types, limbs = env.table.space.types, len(env.table.robot.limbs)
        code = [f"damage {kind}@{limb}" for limb in range(limbs) for kind in types]
        assert env.obs_names[-len(code) :] == code
        env.reset(options={"damage_class": f"{types[1]}@2"})
        obs = env.step(np.zeros((1, env.single_action_space.shape[0])))[0][0]
        row = dict(zip(env.obs_names, obs, strict=True))
        assert [name for name in code if row[name] == 1.0] == [f"damage {types[1]}@2"]
    with contextlib.closing(db.make_vec(robot, 1, max_damaged_limbs=1, observe_damage=False)) as env:
        assert len(env.obs_names) == env.single_observation_space.shape[0]
        assert not any(name.startswith("damage") for name in env.obs_names)


def test_positions_and_velocities_have_the_names_of_their_joints() -> None:
    with contextlib.closing(db.make_vec("ant", 1, damage="healthy", precision="f64", seed=3)) as env:
        env.reset()
        obs = env.step(np.full((1, 8), 0.5))[0][0]
        row = dict(zip(env.obs_names, obs, strict=True))
        units = dict(zip(env.obs_names, env.obs_units, strict=True))
        qpos, qvel = (values[0] for values in env.get_state())
        model = env.table.models[0]
        hinges = [model.joint(index) for index in range(1, model.njnt)]
        assert len(hinges) == 8
        for joint in hinges:
            assert row[f"qpos {joint.name}"] == pytest.approx(qpos[joint.qposadr[0]], rel=1e-6)
            assert row[f"qvel {joint.name}"] == pytest.approx(qvel[joint.dofadr[0]], rel=1e-6)
            assert (units[f"qpos {joint.name}"], units[f"qvel {joint.name}"]) == ("rad", "rad/s")
        assert row["qpos root z"] == pytest.approx(qpos[2], rel=1e-6)
        assert row["qpos root quat w"] == pytest.approx(qpos[3], rel=1e-6)
        assert row["qvel root lin x"] == pytest.approx(qvel[0], rel=1e-6)
        assert row["qvel root ang z"] == pytest.approx(qvel[5], rel=1e-6)


def test_steps_of_a_history_have_their_age(tmp_path: Path) -> None:
    task = observed('{ term = "joint_pos", history = 3, delay = 1 }, { term = "foot_vel" }')
    with contextlib.closing(
        make_walker(tmp_path, task + "[rewards]\nsurvive = { weight = 1.0 }\n", "mujoco")
    ) as env:
        model, width = env.table.models[0], 4
        joints = [model.joint(model.actuator(index).trnid[0]).name for index in range(width)]
        expected = [f"joint_pos {joint} t-{age}" for age in (3, 2, 1) for joint in joints]
        assert env.obs_names[: 3 * width] == expected
        limbs = tomllib.loads(Path(env.table.robot.path).read_text())["limbs"]
        assert env.obs_names[3 * width :][:6] == [
            f"foot_vel {limb['name']} {axis}" for limb in limbs for axis in "xyz"
        ]
