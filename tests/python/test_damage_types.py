"""Damage types change exactly what they name, and the compiler derives the rest."""

from __future__ import annotations

import math
from pathlib import Path

import mujoco
import numpy as np
import pytest

from dappo_batch._core import ConfigError
from dappo_batch.damage import (
    DAMAGE_TYPES,
    DamageType,
    JammedJoint,
    MissingToe,
    WeakMotor,
    make_damage_type,
)
from dappo_batch.robots import Limb, Robot, load_robot

TRIPOD = Path(__file__).parent / "robots" / "tripod.toml"


def damaged(robot: Robot, damage: DamageType, limb: int, severity: float = 1.0) -> mujoco.MjModel:
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    damage.apply(spec, robot.limbs[limb], severity)
    return spec.compile()


def healthy(robot: Robot) -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(robot.mjcf_path))


def from_edited_mjcf(robot: Robot, old: str, new: str) -> mujoco.MjModel:
    text = robot.mjcf_path.read_text()
    assert text.count(old) == 1
    return mujoco.MjModel.from_xml_string(text.replace(old, new))


def numeric_differences(a: mujoco.MjModel, b: mujoco.MjModel) -> set[str]:
    names = [name for name in dir(a) if isinstance(getattr(a, name), np.ndarray)]
    return {name for name in names if not np.array_equal(getattr(a, name), getattr(b, name))}


@pytest.mark.parametrize("name", ["ant", "hexapod", TRIPOD])
def test_a_jammed_joint_changes_nothing_but_one_joint_range(name: str | Path) -> None:
    robot = load_robot(name)
    sound, jammed = healthy(robot), damaged(robot, JammedJoint(), 1)
    assert numeric_differences(sound, jammed) == {"jnt_range"}
    changed = np.flatnonzero(np.any(sound.jnt_range != jammed.jnt_range, axis=1))
    assert changed.tolist() == [sound.joint(robot.limbs[1].joints[0]).id]


@pytest.mark.parametrize(
    "name", ["ant", "hexapod", TRIPOD]
)  # two write degrees in their MJCF, the third radians
def test_a_jammed_joint_keeps_a_tenth_of_a_degree_to_both_sides(name: str | Path) -> None:
    robot = load_robot(name)
    model = damaged(robot, JammedJoint(), 0)
    limit = math.radians(0.1)
    assert model.joint(robot.limbs[0].joints[0]).range == pytest.approx([-limit, limit], rel=1e-12)


def test_the_severity_moves_both_ends_of_the_range_linearly() -> None:
    robot = load_robot("ant")
    model = damaged(robot, JammedJoint(joint=1, range_deg=2.0), 0, severity=0.25)
    # ankle_1 goes from 30..70 towards -2..2 degrees
    assert np.rad2deg(model.joint("ankle_1").range) == pytest.approx([22.0, 53.0])


def test_a_jammed_hip_of_the_ant_leaks_only_a_little_under_full_torque() -> None:
    robot = load_robot("ant")
    sound, jammed = healthy(robot), damaged(robot, JammedJoint(), 0)
    swings = []
    for model in (sound, jammed):
        data = mujoco.MjData(model)
        angle = 0.0
        for step in range(400):
            data.ctrl[2] = 1.0 if step % 40 < 20 else -1.0
            mujoco.mj_step(model, data)
            angle = max(angle, abs(float(data.joint("hip_1").qpos[0])))
        swings.append(math.degrees(angle))
    assert swings[0] > 25
    assert swings[1] < 1


def test_the_stump_of_the_ant_equals_a_hand_written_short_capsule() -> None:
    robot = load_robot("ant")
    tip = 0.01 / math.sqrt(2)
    expected = from_edited_mjcf(robot, 'fromto="0 0 0 -0.4 0.4 0"', f'fromto="0 0 0 {-tip!r} {tip!r} 0"')
    model = damaged(robot, MissingToe(half_length=0.005), 1)
    for name in ("mass", "inertia", "ipos"):
        assert getattr(model.body("back_left_toe"), name) == pytest.approx(
            getattr(expected.body("back_left_toe"), name), rel=1e-12, abs=1e-15
        )
    assert model.geom("back_left_toe").size == pytest.approx([0.08, 0.005, 0])
    # density 5 times the volume of a capsule of radius 0.08 and half-length 0.005
    mass = 5 * math.pi * 0.08**2 * (2 * 0.005 + 4 / 3 * 0.08)
    assert model.body("back_left_toe").mass == pytest.approx(mass)
    assert model.body_subtreemass[0] == pytest.approx(expected.body_subtreemass[0], rel=1e-12)
    assert model.dof_invweight0 == pytest.approx(expected.dof_invweight0, rel=1e-9)


def test_the_stump_of_the_hexapod_weighs_its_share_of_the_tibias_volume() -> None:
    robot = load_robot("hexapod")
    volume = {half: math.pi * 0.025**2 * 2 * half + 4 / 3 * math.pi * 0.025**3 for half in (0.01, 0.07)}
    mass = 0.06 * volume[0.01] / volume[0.07]
    expected = from_edited_mjcf(
        robot,
        '<geom name="left_rear_tibia" class="tibia"/>',
        f'<geom name="left_rear_tibia" class="tibia" fromto="0 0 0 0.02 0 0" mass="{mass!r}"/>',
    )
    model = damaged(robot, MissingToe(half_length=0.01), 3)
    body, reference = model.body("left_rear_tibia"), expected.body("left_rear_tibia")
    assert body.mass == pytest.approx(mass)
    assert body.mass == pytest.approx(reference.mass, rel=1e-12)
    assert body.inertia == pytest.approx(reference.inertia, rel=1e-12)
    assert body.ipos == pytest.approx([0.01, 0, 0])


def test_the_touch_site_of_the_hexapod_shrinks_with_the_tibia() -> None:
    model = damaged(load_robot("hexapod"), MissingToe(half_length=0.01), 3)
    assert model.site("left_rear_touch").size[:2] == pytest.approx([0.03, 0.01])
    assert model.site("left_rear_touch").pos == pytest.approx([0.01, 0, 0])
    assert model.site("left_front_touch").size[:2] == pytest.approx([0.03, 0.07])


@pytest.mark.parametrize("name", ["ant", "hexapod", TRIPOD])
def test_a_stump_keeps_its_end_at_the_joint_its_direction_and_its_radius(name: str | Path) -> None:
    robot = load_robot(name)
    toe = robot.limbs[2].toe_geom
    sound, broken = healthy(robot), damaged(robot, MissingToe(half_length=0.004), 2)
    ends = []
    for model in (sound, broken):
        geom = model.geom(toe)
        axis = np.zeros(3)
        mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, 1.0]), geom.quat)
        tips = [geom.pos - axis * geom.size[1], geom.pos + axis * geom.size[1]]
        ends.append(sorted(tips, key=lambda tip: float(np.linalg.norm(tip))))
    (near, far), (stump_near, stump_far) = ends
    assert stump_near == pytest.approx(near, abs=1e-12)
    assert np.linalg.norm(stump_far - stump_near) == pytest.approx(0.008)
    direction, stump_direction = far - near, stump_far - stump_near
    assert stump_direction / np.linalg.norm(stump_direction) == pytest.approx(
        direction / np.linalg.norm(direction), abs=1e-12
    )
    assert broken.geom(toe).size[0] == sound.geom(toe).size[0]


def test_the_severity_shortens_the_toe_linearly() -> None:
    model = damaged(load_robot("hexapod"), MissingToe(half_length=0.01), 0, severity=0.5)
    assert model.geom("right_front_tibia").size[1] == pytest.approx(0.04)


@pytest.mark.parametrize(
    ("name", "fields"),
    [
        ("ant", {"actuator_gainprm"}),
        ("hexapod", {"actuator_gainprm", "actuator_biasprm", "actuator_forcerange"}),
    ],
)
def test_a_weak_motor_gives_a_share_of_the_torque_in_every_state(name: str, fields: set[str]) -> None:
    robot = load_robot(name)
    sound, weak = healthy(robot), damaged(robot, WeakMotor(strength=0.5), 1, severity=0.5)
    # MuJoCo derives the acceleration per unit of force, which muscles alone use.
    assert numeric_differences(sound, weak) - {"actuator_acc0"} == fields
    rng = np.random.default_rng(0)
    own = [
        actuator
        for actuator in range(sound.nu)
        if sound.joint(sound.actuator_trnid[actuator, 0]).name in robot.limbs[1].joints
    ]
    share = np.ones(sound.nu)
    share[own] = 0.75
    for _ in range(20):
        ctrl, qpos = rng.uniform(-1, 1, sound.nu), sound.qpos0 + rng.uniform(-0.3, 0.3, sound.nq)
        qvel = rng.normal(size=sound.nv)
        forces = []
        for model in (sound, weak):
            data = mujoco.MjData(model)
            data.ctrl[:], data.qpos[:], data.qvel[:] = ctrl, qpos, qvel
            mujoco.mj_forward(model, data)
            forces.append(data.qfrc_actuator[6:].copy())
        of_joint = sound.jnt_dofadr[sound.actuator_trnid[:, 0]] - 6
        assert forces[1][of_joint] == pytest.approx(share * forces[0][of_joint], rel=1e-12)
    assert len(own) == len(robot.limbs[1].joints)


def test_a_muscle_is_no_motor_that_could_weaken() -> None:
    spec = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body name="b"><joint name="j"/><geom name="toe" size="1"/></body></worldbody>'
        '<actuator><muscle name="biceps" joint="j" lengthrange="0 1"/></actuator></mujoco>'
    )
    with pytest.raises(ConfigError, match="actuator biceps has a gain or a bias of another kind"):
        WeakMotor().apply(spec, Limb(name="only", body="b", joints=("j",), toe_geom="toe"), 1.0)


def test_only_the_missing_toe_mutes_the_touch_signal() -> None:
    assert {name: kind.mutes_touch for name, kind in DAMAGE_TYPES.items()} == {
        "jammed_joint": False,
        "missing_toe": True,
        "weak_motor": False,
    }


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("bent_limb", {}, r"unknown damage type 'bent_limb'.*jammed_joint, missing_toe, weak_motor"),
        ("jammed_joint", {"angle": 1.0}, "unknown parameters angle; expected joint, range_deg"),
        ("jammed_joint", {"joint": 0.5}, "joint must be of type int"),
        ("jammed_joint", {"joint": True}, "joint must be of type int"),
        ("jammed_joint", {"joint": -1}, "counts from 0"),
        ("jammed_joint", {"range_deg": 0.0}, "above 0"),
        ("jammed_joint", {"range_deg": math.nan}, "above 0"),
        ("missing_toe", {}, "missing parameters half_length"),
        ("missing_toe", {"half_length": "short"}, "half_length must be of type float"),
        ("missing_toe", {"half_length": -1}, "above 0"),
        ("weak_motor", {"strength": 1.0}, "below 1"),
        ("weak_motor", {"strength": math.nan}, "below 1"),
    ],
)
def test_a_wrong_damage_type_or_parameter_is_refused(
    name: str, options: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        make_damage_type(name, options)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (JammedJoint(joint=2), "has 2 joints"),
        (MissingToe(half_length=0.3), "below the 0.282843 m"),
    ],
)
def test_damage_that_does_not_fit_the_limb_is_refused(damage: DamageType, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        damaged(load_robot("ant"), damage, 0)


@pytest.mark.parametrize(
    ("body", "damage", "message"),
    [
        ('<joint name="j"/><geom name="toe" type="box" size="1 1 1"/>', MissingToe(0.01), "not a capsule"),
        ('<joint name="j"/><geom name="toe" type="capsule" size="1 1"/>', JammedJoint(), "no limits"),
        (
            '<joint name="j" type="slide" range="0 1"/><geom name="toe" size="1"/>',
            JammedJoint(),
            "not a hinge",
        ),
        (
            '<joint name="j"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>'
            '<geom name="toe" type="capsule" size="1 1"/>',
            MissingToe(0.01),
            "<inertial>",
        ),
        (
            '<joint name="j"/><frame pos="1 0 0"><geom name="toe" type="capsule" size="1 1"/></frame>',
            MissingToe(0.01),
            "<frame>",
        ),
        ('<joint name="k"/><geom name="claw" size="1"/>', JammedJoint(), "no joint 'j'"),
        ('<joint name="j"/><geom name="toe" size="1"/>', WeakMotor(), "no actuator"),
        ('<joint name="k"/><geom name="claw" size="1"/>', MissingToe(0.01), "no geom 'toe'"),
    ],
)
def test_a_limb_that_cannot_break_in_this_way_is_named(body: str, damage: DamageType, message: str) -> None:
    spec = mujoco.MjSpec.from_string(f'<mujoco><worldbody><body name="b">{body}</body></worldbody></mujoco>')
    limb = Limb(name="only", body="b", joints=("j",), toe_geom="toe")
    with pytest.raises(ConfigError, match=message):
        damage.apply(spec, limb, 1.0)
