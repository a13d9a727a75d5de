"""Public robots: on the lane engine and equal to MuJoCo, or refused with a reason."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import mujoco
import numpy as np
import pytest

import dappo_batch
from dappo_batch import ClassTable, ConfigError, compile_class_table
from dappo_batch._core import LaneWorlds
from dappo_batch.robots import load_robot

from ..states import States, converged, evaluate, relative_error
from .poses import KINDS, random_controls, rolled_out
from .vendors import ROBOTS, place

GUIDE = Path(__file__).parents[3] / "docs" / "guides" / "known-robots.md"
STATES_A_CLASS = 6
"""States of each kind for each of the 5 damage classes."""

TOLERANCES = {"f64": 1e-10, "f32": 1e-4}

LONG_LIMBS = {robot: {"f64": 1e-10, "f32": 2e-4} for robot in ("g1_mjlab", "spot_arm")}
"""Seven joints in a row, and those of a waist before them, add up more rounding."""

UNSTABLE = {"spot_arm"}
"""Robots that diverge in MuJoCo itself under random controls, so that no trajectories can be compared."""

LEAST_TOUCHED = {"free": 0.0, "rollout": 0.1, "resting": 0.4, "hard": 0.5}
"""Share of the states of each kind that have a contact."""

REFUSED_AS_PUBLISHED = {
    "a2": "touch each other",
    "aliengo": "touch each other",
    "b2": "touch each other",
    "barkour": "touch each other",
    "g1_mjlab": "touch each other",
    "go1": "touch each other",
    "go1_menagerie": "touch each other",
    "go1_mjlab": "touch each other",
    "go2": "touch each other",
    "humanoid_dm_control": "touch each other",
    "humanoid_gymnasium": "touch each other",
    "hyqreal1": "touch each other",
    "hyqreal2": "touch each other",
    "mini_cheetah": "touch each other",
    "pegasus": "touch each other",
    "quadruped_dm_control": "activation dynamics",
    "spot": "touch each other",
    "spot_arm": "touch each other",
    "spot_menagerie": "touch each other",
}
"""Why the lane engine does not simulate a robot as it is published; it simulates all others."""

REFUSED_SIMPLIFIED = {
    "barkour": "can touch the floor but",
    "quadruped_dm_control": "activation dynamics",
}
"""The same with ``[simplify]``."""


def _is_simplified(robot: str) -> bool:
    return "[simplify]" in (Path(__file__).parent / f"{robot}.toml").read_text()


def test_the_guide_has_the_backends_of_all_robots() -> None:
    rows = [line.split("|")[1:-1] for line in GUIDE.read_text().splitlines() if line.startswith("| [")]
    table = {row[0].partition("]")[0].strip(" ["): (row[4].strip(), row[6].strip()) for row in rows}
    expected = {
        robot: (
            "mujoco" if robot in REFUSED_AS_PUBLISHED else "lanes",
            ("mujoco" if robot in REFUSED_SIMPLIFIED else "lanes") if _is_simplified(robot) else "–",  # noqa: RUF001
        )
        for robot in ROBOTS
    }
    assert table == expected


@pytest.mark.slow
@pytest.mark.parametrize("robot", ROBOTS)
def test_a_robot_as_published_is_equal_or_refused(wheels: Path, robot: str) -> None:
    _check(place(wheels, robot, simplified=False), REFUSED_AS_PUBLISHED.get(robot))


@pytest.mark.slow
@pytest.mark.parametrize("robot", list(filter(_is_simplified, ROBOTS)))
def test_a_simplified_robot_is_equal_or_refused(wheels: Path, robot: str) -> None:
    _check(place(wheels, robot, simplified=True), REFUSED_SIMPLIFIED.get(robot))


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["go1", "go2"])
def test_a_robot_of_the_package_is_equal(robot: str) -> None:
    _check(Path(load_robot(robot).path), None)


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["go1", "go1_menagerie", "spot_menagerie", "aliengo", "b2", "hyqreal2"])
def test_all_damage_of_a_robot_toml_is_equal_on_both_backends(wheels: Path, robot: str) -> None:
    toml = place(wheels, robot, simplified=True)
    table = compile_class_table(toml)
    types = load_robot(str(toml)).damage_types
    assert {"jammed_joint", "missing_shank", "missing_limb"} <= set(types)
    assert len(table.models) == 1 + 4 * len(types)
    assert dappo_batch.make_vec(table, num_envs=2).backend == "lanes"
    _check_forces(table, {"f64": 1e-10})


@pytest.mark.slow
def test_damage_of_a_go1_is_that_of_its_mjcf(wheels: Path) -> None:
    table = compile_class_table(place(wheels, "go1_menagerie", simplified=True))
    healthy = table.models[0]
    of = {item.name: model for item, model in zip(table.space.classes, table.models, strict=True)}
    # The calf of the keyframe `home` is at -1.8 rad.
    assert of["jammed_joint@0"].joint("FL_calf_joint").range == pytest.approx(-1.8 + np.radians([-1, 1]))
    # A calf of 0.195862 kg, of which a tenth of the 0.213 m to the foot remains.
    shank = of["missing_shank@1"]
    assert shank.body("RL_calf").mass == pytest.approx(0.0195862)
    assert shank.body("RL_calf").ipos == pytest.approx([0.00429862, 0.000976676, -0.0146197])
    assert shank.geom("RL").pos == pytest.approx([0, 0, -0.0213])
    assert shank.geom("RL").size[0] == pytest.approx(0.0023)
    # Hip, thigh and calf: 0.68, 1.009 and 0.195862 kg.
    limb = of["missing_limb@2"]
    left = 0.1 * 0.68 + 1e-4 * (1.009 + 0.195862)
    assert limb.body("RR_hip").subtreemass == pytest.approx(left)
    assert limb.body("trunk").subtreemass == pytest.approx(5.204 + 3 * (0.68 + 1.009 + 0.195862) + left)
    gains = healthy.actuator_gainprm[:, 0].copy()
    gains[[healthy.actuator(f"FR_{joint}").id for joint in ("hip", "thigh", "calf")]] = 0
    assert of["dead_motor@3"].actuator_gainprm[:, 0].tolist() == gains.tolist()


@pytest.mark.slow
def test_a_robot_that_can_touch_itself_walks_without_a_limb(wheels: Path) -> None:
    table = compile_class_table(place(wheels, "go1_menagerie", simplified=False), types=["missing_limb"])
    model = table.models[1]
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    lost = {model.body(name).id for name in ("FL_thigh", "FL_calf")}
    rng = np.random.default_rng(0)
    for _ in range(50):
        data.ctrl[:] = model.key_ctrl[0] + 0.3 * rng.normal(size=model.nu)
        mujoco.mj_step(model, data, nstep=5)
        bodies = model.geom_bodyid[data.contact.geom]
        assert not any(lost & set(pair) and 0 not in pair for pair in bodies.tolist())
    assert not any(warning.number for warning in data.warning)


def _check(toml: Path, reason: str | None) -> None:
    if reason is not None:
        _check_refusal(compile_class_table(toml, max_damaged_limbs=0), reason)
        return
    # Meshes make classes slow to compile: one type of damage is enough to have models that differ.
    table = compile_class_table(toml, types=load_robot(str(toml)).damage_types[:1])
    assert dappo_batch.make_vec(table, num_envs=2).backend == "lanes"
    _check_forces(table, LONG_LIMBS.get(table.robot.name, TOLERANCES))
    if table.robot.name not in UNSTABLE:
        _check_trajectories(table)


def _check_refusal(table: ClassTable, reason: str) -> None:
    """Check the reason, and that the robot moves on the other backend."""
    with pytest.raises(ConfigError, match=reason):
        LaneWorlds(table, np.zeros(1, dtype=np.int64))
    envs = dappo_batch.make_vec(table, num_envs=2, seed=0)
    assert envs.backend == "mujoco"
    assert re.search(reason, envs.backend_note)
    envs.reset()
    obs, *_ = envs.step(np.zeros((2, table.models[0].nu), dtype=np.float32))
    assert np.isfinite(obs).all()


def _check_forces(table: ClassTable, tolerances: Mapping[str, float] = TOLERANCES) -> None:
    """Compare accelerations and contact forces, with a tolerance for each precision."""
    for kind, states_of in KINDS.items():
        rng = np.random.default_rng(0)
        parts = []
        for number, model in enumerate(table.models):
            drawn = states_of(model, STATES_A_CLASS, rng)
            # Numbers of single precision, so that both precisions evaluate the very same states.
            states = States(*(array.astype(np.float32).astype(float) for array in drawn))
            parts.append((np.full(STATES_A_CLASS, number), *states, *evaluate(converged(model), states)))
        classes, *arrays = map(np.concatenate, zip(*parts, strict=True))
        states, (qacc, qacc_smooth, cfrc_ext, _) = States(*arrays[:3]), arrays[3:]
        touched = np.any(cfrc_ext, axis=(1, 2)).mean()
        assert LEAST_TOUCHED[kind] <= touched <= float(kind != "free"), (kind, touched)
        for precision, tolerance in tolerances.items():
            got, forces, _ = LaneWorlds(table, classes, precision=precision).forward(*states)
            # At rest gravity and contacts cancel; single precision keeps digits of them, not of their sum.
            scale = qacc_smooth if (precision, kind) == ("f32", "resting") else qacc
            errors = relative_error(got, qacc, scale), relative_error(forces, cfrc_ext)
            assert errors[0] < tolerance, (kind, precision, errors)
            # The force of a stiff contact is the small difference of large accelerations beyond the limits.
            assert errors[1] < (1e-2 if (precision, kind) == ("f32", "hard") else tolerance), (kind, errors)


def _check_trajectories(table: ClassTable) -> None:
    substeps = int(table.robot.spec["frame_skip"])
    rng = np.random.default_rng(1)
    parts = [rolled_out(model, 2, rng) for model in table.models]
    qpos, qvel, _ = map(np.concatenate, zip(*parts, strict=True))
    classes = np.repeat(np.arange(len(table.models)), 2)
    models = [converged(table.models[number]) for number in classes]
    datas = [mujoco.MjData(model) for model in models]
    for data, position, velocity in zip(datas, qpos, qvel, strict=True):
        data.qpos[:], data.qvel[:] = position, velocity
    worlds = LaneWorlds(table, classes, precision="f64")
    for _ in range(20):
        ctrl = np.array([random_controls(model, rng) for model in models])
        qpos, qvel, _, _ = worlds.step(qpos, qvel, ctrl, substeps)
        for model, data, control in zip(models, datas, ctrl, strict=True):
            data.ctrl[:] = control
            mujoco.mj_step(model, data, nstep=substeps)
    errors = [
        relative_error(got, np.array([getattr(data, name) for data in datas]))
        for name, got in (("qpos", qpos), ("qvel", qvel))
    ]
    assert max(errors) < 1e-10, errors
