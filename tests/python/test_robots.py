"""The robots: Gymnasium's physics for the Ant, published numbers for the Hexapod, no code for a third one."""

from __future__ import annotations

import math
from pathlib import Path

import gymnasium
import mujoco
import numpy as np
import pytest

from dappo_batch._core import ConfigError
from dappo_batch.model import compile_class_table
from dappo_batch.robots import ROBOTS, load_robot

TRIPOD = Path(__file__).parent / "robots" / "tripod.toml"
GYMNASIUM_ANT = Path(gymnasium.__file__).parent / "envs" / "mujoco" / "assets" / "ant.xml"

# Everything about looks, names and texts, and nothing else, may differ from Gymnasium's Ant.
LOOKS = (
    "mat_",
    "tex_",
    "light_",
    "cam_",
    "name_",
    "names",
    "paths",
    "text_",
    "numeric_",
    "geom_rgba",
    "geom_matid",
)


def physical_arrays(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    arrays = {name: getattr(model, name) for name in dir(model) if not name.startswith(("_", *LOOKS))}
    return {name: value for name, value in arrays.items() if isinstance(value, np.ndarray)}


@pytest.fixture(scope="module")
def ant() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(load_robot("ant").mjcf_path))


@pytest.fixture(scope="module")
def gymnasium_ant() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(GYMNASIUM_ANT))


@pytest.fixture(scope="module")
def hexapod() -> mujoco.MjModel:
    return compile_class_table("hexapod", max_damaged_limbs=0).models[0]


def test_the_package_ships_four_robots() -> None:
    assert ROBOTS == ("ant", "go1", "go2", "hexapod")


def test_the_ant_has_the_sizes_of_ant_v5(ant: mujoco.MjModel) -> None:
    assert (ant.nbody, ant.njnt, ant.nq, ant.nv, ant.nu, ant.ngeom) == (14, 9, 15, 14, 8, 14)
    assert ant.body_mass.sum() == pytest.approx(0.91088, abs=1e-6)


def test_every_physical_array_of_the_ant_equals_gymnasiums(
    ant: mujoco.MjModel, gymnasium_ant: mujoco.MjModel
) -> None:
    ours, theirs = physical_arrays(ant), physical_arrays(gymnasium_ant)
    assert {
        "body_mass",
        "body_inertia",
        "body_ipos",
        "jnt_range",
        "actuator_gear",
        "actuator_trnid",
        "qpos0",
    } <= set(ours)
    different = [name for name in theirs if not np.array_equal(ours[name], theirs[name])]
    assert different == []


def test_every_option_and_statistic_of_the_ant_equals_gymnasiums(
    ant: mujoco.MjModel, gymnasium_ant: mujoco.MjModel
) -> None:
    for part in ("opt", "stat"):
        ours, theirs = getattr(ant, part), getattr(gymnasium_ant, part)
        names = [name for name in dir(theirs) if not name.startswith("_")]
        values = {name: getattr(theirs, name) for name in names if not callable(getattr(theirs, name))}
        assert values
        assert [
            name for name, value in values.items() if not np.array_equal(getattr(ours, name), value)
        ] == []


def test_the_actuators_of_the_ant_come_in_the_order_of_gymnasium(ant: mujoco.MjModel) -> None:
    joints = [ant.joint(ant.actuator_trnid[index, 0]).name for index in range(ant.nu)]
    assert joints == ["hip_4", "ankle_4", "hip_1", "ankle_1", "hip_2", "ankle_2", "hip_3", "ankle_3"]


def test_the_ant_moves_bit_for_bit_like_gymnasiums_for_1000_random_steps(
    ant: mujoco.MjModel, gymnasium_ant: mujoco.MjModel
) -> None:
    rng = np.random.default_rng(0)
    ours, theirs = mujoco.MjData(ant), mujoco.MjData(gymnasium_ant)
    ours.qpos[:] = theirs.qpos[:] = theirs.qpos + rng.uniform(-0.1, 0.1, ant.nq)
    touched = 0
    for _ in range(1000):
        ours.ctrl[:] = theirs.ctrl[:] = rng.uniform(-1, 1, ant.nu)
        mujoco.mj_step(ant, ours, nstep=5)
        mujoco.mj_step(gymnasium_ant, theirs, nstep=5)
        touched += theirs.ncon > 0
        assert np.array_equal(ours.qpos, theirs.qpos)
        assert np.array_equal(ours.qvel, theirs.qvel)
    assert touched > 500  # a robot in the air would prove little


def test_limbs_of_the_ant_lie_as_a_ring_and_begin_in_front_on_the_left() -> None:
    table = compile_class_table("ant", max_damaged_limbs=0)
    assert table.limb_bodies == ((2, 3, 4), (5, 6, 7), (8, 9, 10), (11, 12, 13))
    data = table.worker_data(1)[0]
    mujoco.mj_forward(table.models[0], data)
    signs = [np.sign(data.xpos[bodies[-1]][:2]).tolist() for bodies in table.limb_bodies]
    assert signs == [[1, 1], [-1, 1], [-1, -1], [1, -1]]


def test_the_hexapod_has_the_sizes_of_the_paper(hexapod: mujoco.MjModel) -> None:
    assert (hexapod.nq, hexapod.nv, hexapod.nu) == (25, 24, 18)
    assert hexapod.sensor_type.tolist() == [mujoco.mjtSensor.mjSENS_TOUCH] * 6
    assert hexapod.nq - 2 + hexapod.nv + 6 == 53
    assert hexapod.opt.timestep * load_robot("hexapod").spec["frame_skip"] == pytest.approx(0.015)


def test_the_hexapod_has_the_published_masses_and_mounts(hexapod: mujoco.MjModel) -> None:
    assert hexapod.body("torso").mass == pytest.approx(1.6)
    mounts = {
        "right_front": (0.12, -0.06, -67.5),
        "right_middle": (0.0, -0.10, -90.0),
        "right_rear": (-0.12, -0.06, -112.5),
        "left_rear": (-0.12, 0.06, 112.5),
        "left_middle": (0.0, 0.10, 90.0),
        "left_front": (0.12, 0.06, 67.5),
    }
    assert tuple(mounts) == tuple(limb.name for limb in load_robot("hexapod").limbs)
    for name, (x, y, yaw) in mounts.items():
        coxa = hexapod.body(f"{name}_coxa")
        assert coxa.pos == pytest.approx([x, y, 0])
        half = math.radians(yaw) / 2
        assert coxa.quat == pytest.approx([math.cos(half), 0, 0, math.sin(half)])
        masses = [hexapod.body(f"{name}_{part}").mass[0] for part in ("coxa", "femur", "tibia")]
        assert masses == pytest.approx([0.02, 0.18, 0.06])


def test_the_hexapod_stands_still_at_a_height_of_20_cm(hexapod: mujoco.MjModel) -> None:
    data = mujoco.MjData(hexapod)
    heights = []
    for _ in range(1000):
        mujoco.mj_step(hexapod, data, nstep=3)
        heights.append(float(data.qpos[2]))
    assert min(heights) >= 0.200
    assert max(heights) <= 0.202


def test_the_hexapod_walks_with_an_open_loop_tripod_gait(hexapod: mujoco.MjModel) -> None:
    data = mujoco.MjData(hexapod)
    steps, dt = 400, 0.015
    for step in range(steps):
        for limb in range(6):
            # Neighbours in the ring move in opposite phase; limbs 0 to 2 are on the right.
            phase = 2 * math.pi * 2.0 * step * dt + math.pi * (limb % 2)
            side = -1 if limb < 3 else 1
            data.ctrl[3 * limb] = side * 0.785 * math.cos(phase)
            data.ctrl[3 * limb + 1] = 0.4 * max(0.0, math.sin(phase))
        mujoco.mj_step(hexapod, data, nstep=3)
    assert 0.6 <= data.qpos[0] / (steps * dt) <= 0.8


@pytest.mark.parametrize("name", ROBOTS)
def test_a_robot_cannot_touch_itself(name: str) -> None:
    model = mujoco.MjModel.from_xml_path(str(load_robot(name).mjcf_path))
    robot = model.geom_bodyid > 0
    assert not np.any(model.geom_conaffinity[robot])
    assert model.geom("floor").conaffinity == 1


def test_a_new_robot_needs_no_code() -> None:
    table = compile_class_table(TRIPOD)
    assert len(table.models) == 27  # sum over j of 2^j C(3, j)
    assert table.models[0].npair == 7
    assert table.touch_addresses == (0, 1, 2)
    assert table.limb_bodies == ((2, 3), (4, 5), (6, 7))
    model, data = table.models[0], table.worker_data(1)[0]
    mujoco.mj_step(model, data, nstep=400)
    assert data.qpos[2] > 0.1
    assert np.all(data.sensordata > 0)


def test_an_unknown_robot_is_rejected_with_a_list_of_the_known_ones() -> None:
    with pytest.raises(ConfigError, match=r"'spider'.*ant, go1, go2, hexapod.*robot TOML"):
        load_robot("spider")


def test_a_missing_robot_file_is_in_the_error(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"missing\.toml"):
        load_robot(tmp_path / "missing.toml")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('main_body = "torso"', "", "the entry `main_body` is missing"),
        ('joints = ["hip_1", "ankle_1"]', 'joints = "hip_1"', 'limb 0: `joints` is "hip_1", expected a list'),
        ('body = "front_left_limb"', "", "limb 0: the entry `body` is missing"),
        ('toe_geom = "front_left_toe"', 'toe_geom = "x"\ncolour = "red"', "unknown entries colour"),
        (
            "max_damaged_limbs = 2",
            "max_damaged_limbs = true",
            "`max_damaged_limbs` is true, expected a whole number from 0 to 4",
        ),
        ('mjcf = "ant.xml"', 'mjcf = "bee.xml"', "bee.xml"),
        ("[damage]", "[damage", "not valid TOML"),
    ],
)
def test_a_faulty_robot_toml_is_rejected_with_the_entry(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    robot = load_robot("ant")
    assert old in robot.toml_text
    (tmp_path / "ant.xml").write_text(robot.mjcf_path.read_text())
    path = tmp_path / "faulty.toml"
    path.write_text(robot.toml_text.replace(old, new, 1))
    with pytest.raises(ConfigError, match=message):
        load_robot(path)
