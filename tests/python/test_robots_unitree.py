"""Go1 and Go2: the numbers that Unitree and others publish, and that the robots stand."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import dappo_batch
from dappo_batch.robots import load_robot

Array = NDArray[np.float64]

SIDES = {"FR": (1, -1), "FL": (1, 1), "RR": (-1, -1), "RL": (-1, 1)}
"""Signs of x and y of each leg, in the order of Unitree's SDK."""
JOINTS = ("hip", "thigh", "calf")


@dataclass(frozen=True)
class Link:
    """Inertial data of a link: mass, centre of mass, and ixx, iyy, izz, ixy, ixz, iyz about it."""

    mass: float
    com: tuple[float, float, float]
    inertia: tuple[float, float, float, float, float, float]

    def matrix(self) -> Array:
        """Return the inertia about the centre of mass, [3, 3]."""
        xx, yy, zz, xy, xz, yz = self.inertia
        return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


ROTOR_Y = (5.9647e-05, 0.000111842, 5.9647e-05, 0.0, 0.0, 0.0)
FOOT = (9.6e-06, 9.6e-06, 9.6e-06, 0.0, 0.0, 0.0)

# The links of the front left leg, and those that are fixed to them: rotors and the foot.
# go1: robots/go1_description/urdf/go1.urdf of github.com/unitreerobotics/unitree_ros.
# go2: robots/go2_description/urdf/go2_description.urdf. The calf with its foot is that of MuJoCo Menagerie's
# unitree_go2/go2.xml, whose principal inertias are below.
LINKS = {
    "go1": {
        "trunk": [
            Link(
                5.204,
                (0.0223, 0.002, -0.0005),
                (0.0168128557, 0.063009565, 0.0716547275, -0.0002296769, -0.0002945293, -4.18731e-05),
            )
        ],
        "hip": [
            Link(
                0.591,
                (-0.005657, -0.008752, -0.000102),
                (0.000334008405, 0.000619101213, 0.00040057614, -1.0826066e-05, 1.290732e-06, 1.643194e-06),
            ),
            Link(0.089, (0.0, -0.00015, 0.0), ROTOR_Y),
        ],
        "thigh": [
            Link(
                0.92,
                (-0.003342, -0.018054, -0.033451),
                (
                    0.004431760472,
                    0.004485671726,
                    0.000740309489,
                    5.7496807e-05,
                    -0.000218457134,
                    0.000572001265,
                ),
            ),
            Link(0.089, (0.0, -0.03235, 0.0), ROTOR_Y),
        ],
        "calf": [
            Link(
                0.135862,
                (0.006197, 0.001408, -0.116695),
                (0.001088793059, 0.001100428748, 2.4787446e-05, -2.55679e-07, 7.117814e-06, 2.077264e-06),
            ),
            Link(0.06, (0.0, 0.0, -0.213), FOOT),
        ],
    },
    "go2": {
        "base": [
            Link(
                6.921,
                (0.021112, 0.0, -0.005366),
                (0.02448, 0.098077, 0.107, 0.00012166, 0.0014849, -3.12e-05),
            )
        ],
        "hip": [
            Link(
                0.678,
                (-0.0054, 0.00194, -0.000105),
                (0.00048, 0.000884, 0.000596, -3.01e-06, 1.11e-06, -1.42e-06),
            )
        ],
        "thigh": [
            Link(
                1.152,
                (-0.00374, -0.0223, -0.0327),
                (0.00584, 0.0058, 0.00103, 8.72e-05, -0.000289, 0.000808),
            )
        ],
    },
}


@dataclass(frozen=True)
class Geometry:
    """Places of the joints of the front left leg, m; ranges, rad; torques, N·m; IMU, m."""

    trunk: str
    hip: tuple[float, float, float]
    thigh_y: float
    foot: tuple[float, float, float]
    imu: tuple[float, float, float]
    ranges: dict[str, tuple[float, float]]
    torques: tuple[float, float, float]
    mass: float


# From the same files; the masses of MuJoCo Menagerie's models, which leave out rotors and head of the trunk.
GEOMETRY = {
    "go1": Geometry(
        "trunk",
        (0.1881, 0.04675, 0.0),
        0.08,
        (0.0, 0.0, -0.213),
        (-0.01592, -0.06659, -0.00617),
        {
            "hip": (-0.863, 0.863),
            "F_thigh": (-0.686, 4.501),
            "R_thigh": (-0.686, 4.501),
            "calf": (-2.818, -0.888),
        },
        (23.7, 23.7, 35.55),
        12.743448,
    ),
    "go2": Geometry(
        "base",
        (0.1934, 0.0465, 0.0),
        0.0955,
        (-0.002, 0.0, -0.213),
        (-0.02557, 0.0, 0.04232),
        {
            "hip": (-1.0472, 1.0472),
            "F_thigh": (-1.5708, 3.4907),
            "R_thigh": (-0.5236, 4.5379),
            "calf": (-2.7227, -0.83776),
        },
        (23.7, 23.7, 45.43),
        15.206408,
    ),
}

robots = pytest.mark.parametrize("name", list(GEOMETRY))


def compiled(name: str) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(load_robot(name).mjcf_path))


def in_home_pose(model: mujoco.MjModel) -> mujoco.MjData:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("home").id)
    mujoco.mj_forward(model, data)
    return data


def inertia_of(model: mujoco.MjModel, body: int) -> Array:
    """Return the inertia of a body about its centre of mass, in the axes of the body, [3, 3]."""
    axes = np.empty(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])
    return axes.reshape(3, 3) @ np.diag(model.body_inertia[body]) @ axes.reshape(3, 3).T


def joined(links: list[Link]) -> tuple[float, Array, Array]:
    """Return mass, centre of mass and inertia about it of links that are fixed to each other."""
    mass = sum(link.mass for link in links)
    com: Array = sum((link.mass * np.array(link.com) for link in links), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for link in links:
        arm = np.array(link.com) - com
        inertia += link.matrix() + link.mass * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return mass, com, inertia


def turned(axis: int, angle: float) -> Array:
    """Return the rotation about an axis, [3, 3]."""
    cos, sin = np.cos(angle), np.sin(angle)
    after, before = (axis + 1) % 3, (axis + 2) % 3
    matrix = np.eye(3)
    matrix[[after, before, after, before], [after, before, before, after]] = cos, cos, -sin, sin
    return matrix


@robots
def test_masses_and_inertias_are_unitrees(name: str) -> None:
    model = compiled(name)
    assert model.body_mass.sum() == pytest.approx(GEOMETRY[name].mass, abs=1e-9)
    for part, links in LINKS[name].items():
        mass, com, inertia = joined(links)
        legs = SIDES if part in JOINTS else {"": (1, 1)}
        for leg, (x, y) in legs.items():
            body = model.body(f"{leg}_{part}" if leg else part).id
            # Hips are mirrored along x and y, thighs along y; the Go1 has the same calf on both sides.
            mirror = np.diag([x if part == "hip" else 1, 1 if part == "calf" else y, 1])
            assert model.body_mass[body] == pytest.approx(mass, abs=1e-9)
            assert model.body_ipos[body] == pytest.approx(mirror @ com, abs=2e-7)  # six digits
            expected = mirror @ inertia @ mirror
            assert inertia_of(model, body) == pytest.approx(expected, abs=5e-6 * np.trace(expected))


def test_the_calf_of_the_go2_is_menageries() -> None:
    model = compiled("go2")
    for leg, (_, y) in SIDES.items():
        calf = model.body(f"{leg}_calf")
        assert calf.mass[0] == 0.241352
        assert calf.ipos == pytest.approx([0.00629595, -0.000622121 * y, -0.141417])
        principal = [0.0014901, 0.00146356, 5.31397e-05]
        assert calf.inertia == pytest.approx(principal, rel=1e-5)


@robots
def test_links_joints_and_torques_are_unitrees(name: str) -> None:
    model, geometry = compiled(name), GEOMETRY[name]
    data = in_home_pose(model)
    rng = np.random.default_rng(0)
    for _ in range(20):
        data.qpos[7:] = rng.uniform(*model.jnt_range[1:].T)
        mujoco.mj_kinematics(model, data)
        for leg, (x, y) in SIDES.items():
            hip, thigh, calf = (data.joint(f"{leg}_{joint}_joint") for joint in JOINTS)
            angles = [float(joint.qpos[0]) for joint in (hip, thigh, calf)]
            axes = [turned(0, angles[0]), turned(1, angles[1]), turned(1, angles[2])]
            place = data.xpos[1] + np.multiply(geometry.hip, (x, y, 1))
            assert hip.xanchor == pytest.approx(place, abs=1e-9)
            assert hip.xaxis == pytest.approx([1, 0, 0], abs=1e-9)
            place = place + axes[0] @ (0, geometry.thigh_y * y, 0)
            assert thigh.xanchor == pytest.approx(place, abs=1e-9)
            place = place + axes[0] @ axes[1] @ (0, 0, -0.213)
            assert calf.xanchor == pytest.approx(place, abs=1e-9)
            for joint in (thigh, calf):
                assert joint.xaxis == pytest.approx(axes[0] @ (0, 1, 0), abs=1e-9)
            place = place + axes[0] @ axes[1] @ axes[2] @ geometry.foot
            assert data.geom(leg).xpos == pytest.approx(place, abs=1e-6)
            assert data.site(leg).xpos == pytest.approx(place, abs=1e-6)
    assert model.site("imu").pos == pytest.approx(geometry.imu)
    for leg in SIDES:
        for joint, torque in zip(JOINTS, geometry.torques, strict=True):
            limits = geometry.ranges[f"{leg[0]}_thigh" if joint == "thigh" else joint]
            assert model.joint(f"{leg}_{joint}_joint").range == pytest.approx(limits)
            assert model.actuator(f"{leg}_{joint}").ctrlrange == pytest.approx(limits)
            assert model.actuator(f"{leg}_{joint}").forcerange == pytest.approx([-torque, torque])


@robots
def test_actuators_are_position_servos_in_unitrees_order(name: str) -> None:
    model = compiled(name)
    order = [f"{leg}_{joint}" for leg in SIDES for joint in JOINTS]
    assert [model.actuator(index).name for index in range(model.nu)] == order
    assert [model.joint(model.actuator_trnid[index, 0]).name for index in range(model.nu)] == [
        f"{actuator}_joint" for actuator in order
    ]
    # MuJoCo Playground's Go1; MuJoCo Menagerie's unitree_go2/go2_mjx.xml.
    kp, kv = {"go1": (35, 0.5), "go2": (50, 0.5)}[name]
    assert np.unique(model.actuator_gainprm[:, 0]) == [kp]
    assert np.unique(model.actuator_biasprm[:, :3], axis=0).tolist() == [[0, -kp, -kv]]
    assert set(model.geom_friction[[model.geom(leg).id for leg in ("floor", *SIDES)], 0]) == {0.6}


@robots
def test_an_env_step_takes_20_ms_on_the_lane_engine_without_changes(name: str) -> None:
    report = dappo_batch.check_robot(name)
    assert (report.backend, report.notes, report.edits) == ("lanes", (), ())
    assert report.timestep * load_robot(name).spec["frame_skip"] == pytest.approx(0.02)
    assert report.floor_contacts == tuple(SIDES)


@robots
def test_only_the_feet_and_the_floor_have_contacts(name: str) -> None:
    model = compiled(name)
    solid = np.flatnonzero(model.geom_contype | model.geom_conaffinity)
    assert [model.geom(int(geom)).name for geom in solid] == ["floor", *SIDES]
    assert (model.geom_condim[solid] == 3).all()
    assert model.ngeom <= 60


@robots
def test_limbs_are_a_ring_from_the_front_right(name: str) -> None:
    table = dappo_batch.compile_class_table(name, max_damaged_limbs=0)
    data = in_home_pose(table.models[0])
    signs = [tuple(np.sign(data.xpos[bodies[-1]][:2]).tolist()) for bodies in table.limb_bodies]
    assert signs == [(1, -1), (1, 1), (-1, 1), (-1, -1)]


@robots
def test_a_jammed_calf_stays_at_its_angle_in_the_standing_pose(name: str) -> None:
    table = dappo_batch.compile_class_table(name, max_damaged_limbs=1)
    jammed = table.models[table.space.parse("jammed_joint@2")]
    assert np.degrees(jammed.joint("RL_calf_joint").range + 1.8) == pytest.approx([-0.1, 0.1])


@robots
def test_the_reference_pose_is_the_standing_pose_in_which_the_feet_touch_the_floor(name: str) -> None:
    model = compiled(name)
    data = in_home_pose(model)
    assert data.qpos == pytest.approx(model.qpos0)
    assert data.qpos[7:].reshape(4, 3).tolist() == [[0, 0.9, -1.8]] * 4
    for leg in SIDES:
        gap = data.geom(leg).xpos[2] - model.geom(leg).size[0]
        assert gap == pytest.approx(0, abs=1e-4)


STAND = """
frame_skip = 5
max_episode_steps = 1000
actions = { type = "joint_position", scale = 0.5 }
reset = { keyframe = "home", qpos_noise = 0.0, qvel_noise = 0.0 }
observation = { policy = { terms = [{ term = "foot_contact" }] } }
rewards = { survive = { weight = 1.0 } }
"""


@robots
def test_the_robot_stands_for_five_seconds(name: str, backend: str, tmp_path: Path) -> None:
    heights, upright = stand(name, backend, "ctrl", tmp_path)
    assert np.abs(heights - heights[0]).max() < 0.02
    assert upright > np.cos(np.radians(2))


@robots
def test_targets_equal_to_the_angles_let_the_robot_sink_but_not_fall(
    name: str, backend: str, tmp_path: Path
) -> None:
    heights, upright = stand(name, backend, "qpos", tmp_path)
    assert 0.02 < heights[0] - heights[-1] < 0.05
    assert upright > np.cos(np.radians(5))


def stand(name: str, backend: str, targets: str, folder: Path) -> tuple[Array, float]:
    """Return the heights from the standing pose on and the cosine of the tilt after 5 s of fixed targets."""
    robot = dappo_batch.load_robot(name)
    text = robot.path.read_text().replace('task = "velocity"', 'task = "stand.toml"')
    (folder / "stand.toml").write_text(STAND)
    (folder / robot.path.name).write_text(text)
    (folder / robot.mjcf_path.name).write_bytes(robot.mjcf_path.read_bytes())
    table = dappo_batch.compile_class_table(folder / robot.path.name, max_damaged_limbs=0)
    home = table.models[0].key("home")
    options: dict[str, Any] = {"autoreset": "disabled", "observe_damage": False, "seed": 0}
    envs = dappo_batch.make_vec(table, 1, backend=backend, **options)
    envs.reset()
    # An action of 0 is the control of the keyframe.
    actions = ((home.ctrl if targets == "ctrl" else home.qpos[7:]) - home.ctrl)[None] / 0.5
    heights = [home.qpos[2]]
    for _ in range(250):
        obs, _, terminated, _, _ = envs.step(actions)
        assert not terminated.any()
        heights.append(envs.get_state()[0][0, 2])
    assert obs[0].tolist() == [1.0] * 4  # all feet touch the floor
    return np.array(heights), turned_up(envs.get_state()[0][0, 3:7])


def turned_up(quaternion: Array) -> float:
    """Return the cosine of the angle between the z axis of the robot and that of the world."""
    _, x, y, _ = quaternion
    return float(1 - 2 * (x * x + y * y))
