"""Damage types change exactly what they name, and the compiler derives the rest."""

from __future__ import annotations

import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

import dappo_batch
from dappo_batch._core import ConfigError
from dappo_batch.damage import (
    DAMAGE_TYPES,
    DamageType,
    DeadMotor,
    JammedJoint,
    MissingShank,
    WeakMotor,
    make_damage_type,
    register_damage_type,
)
from dappo_batch.robots import Limb, Robot, load_robot

from .damaged_limbs import LIMB, ONE, limb, numeric_differences

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
    model = damaged(robot, JammedJoint(joint=1, range_deg=2.0, at=50), 0, severity=0.25)
    # ankle_1 goes from 30..70 towards 48..52 degrees
    assert np.rad2deg(model.joint("ankle_1").range) == pytest.approx([34.5, 65.5])


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
    model = damaged(robot, MissingShank(half_length=0.005), 1)
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
    model = damaged(robot, MissingShank(half_length=0.01), 3)
    body, reference = model.body("left_rear_tibia"), expected.body("left_rear_tibia")
    assert body.mass == pytest.approx(mass)
    assert body.mass == pytest.approx(reference.mass, rel=1e-12)
    assert body.inertia == pytest.approx(reference.inertia, rel=1e-12)
    assert body.ipos == pytest.approx([0.01, 0, 0])


def test_the_touch_site_of_the_hexapod_shrinks_with_the_tibia() -> None:
    model = damaged(load_robot("hexapod"), MissingShank(half_length=0.01), 3)
    assert model.site("left_rear_touch").size[:2] == pytest.approx([0.03, 0.01])
    assert model.site("left_rear_touch").pos == pytest.approx([0.01, 0, 0])
    assert model.site("left_front_touch").size[:2] == pytest.approx([0.03, 0.07])


@pytest.mark.parametrize("name", ["ant", "hexapod", TRIPOD])
def test_a_stump_keeps_its_end_at_the_joint_its_direction_and_its_radius(name: str | Path) -> None:
    robot = load_robot(name)
    toe = robot.limbs[2].toe_geom
    sound, broken = healthy(robot), damaged(robot, MissingShank(half_length=0.004), 2)
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
    model = damaged(load_robot("hexapod"), MissingShank(half_length=0.01), 0, severity=0.5)
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


def test_a_muscle_is_not_a_motor_that_can_weaken() -> None:
    spec = mujoco.MjSpec.from_string(
        '<mujoco><worldbody><body name="b"><joint name="j"/><geom name="toe" size="1"/></body></worldbody>'
        '<actuator><muscle name="biceps" joint="j" lengthrange="0 1"/></actuator></mujoco>'
    )
    with pytest.raises(ConfigError, match="actuator biceps has a gain or a bias of another kind"):
        WeakMotor().apply(spec, Limb(name="only", body="b", joints=("j",), toe_geom="toe"), 1.0)


def test_only_a_missing_toe_disables_the_touch_sensor() -> None:
    assert {name: kind.disables_touch for name, kind in DAMAGE_TYPES.items()} == {
        "jammed_joint": False,
        "missing_shank": True,
        "missing_limb": True,
        "missing_toe": True,
        "weak_motor": False,
        "dead_motor": False,
    }


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("bent_limb", {}, r"unknown damage type 'bent_limb'.*jammed_joint, missing_shank, "),
        ("jammed_joint", {"angle": 1.0}, "unknown parameters angle; expected joint, range_deg, at"),
        ("jammed_joint", {"joint": 0.5}, "joint must be of type int"),
        ("jammed_joint", {"joint": True}, "joint must be of type int"),
        ("jammed_joint", {"joint": "(calf"}, "not a regular expression"),
        ("jammed_joint", {"at": "home"}, '"middle", "current" or an angle in degrees, got \'home\''),
        ("jammed_joint", {"at": math.inf}, "an angle in degrees, got inf"),
        ("jammed_joint", {"at": [1.0]}, "at must be of type str | float"),
        ("jammed_joint", {"joint": -1}, "counts from 0"),
        ("jammed_joint", {"range_deg": 0.0}, "above 0"),
        ("jammed_joint", {"range_deg": math.nan}, "above 0"),
        ("missing_toe", {"half_length": "short"}, "half_length must be of type float"),
        ("missing_toe", {"half_length": -1}, "above 0"),
        ("weak_motor", {"strength": 1.0}, "below 1"),
        ("weak_motor", {"joint": -2}, "counts from 0"),
        ("dead_motor", {"joint": 1.5}, r"joint must be of type int \| str \| None"),
        ("weak_motor", {"strength": math.nan}, "below 1"),
    ],
)
def test_a_wrong_damage_type_or_parameter_is_rejected(
    name: str, options: dict[str, object], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        make_damage_type(name, options)


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (JammedJoint(joint=2), "has 2 joints"),
        (JammedJoint(joint="knee"), "'knee' matches no joint and must match one of hip_1, ankle_1"),
        (JammedJoint(joint="_1"), "'_1' matches 2 joints, hip_1, ankle_1"),
        (
            JammedJoint(joint="ankle"),
            r'ankle_1 would jam at 0° \(at = "zero"\), outside of its range of 30° to 70°; use at = "def',
        ),
        (JammedJoint(joint="ankle", at="default"), r"range of 30° to 70°; use \[reset\] keyframe"),
        (JammedJoint(joint=1, at=71), r"would jam at 71° \(at = 71\).*; use an angle within the range"),
        (MissingShank(half_length=0.3), "below the 0.282843 m"),
    ],
)
def test_damage_that_does_not_fit_the_limb_is_rejected(damage: DamageType, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        damaged(load_robot("ant"), damage, 0)


@pytest.mark.parametrize(
    ("body", "damage", "message"),
    [
        ('<joint name="j"/><geom name="toe" type="box" size="1 1 1"/>', MissingShank(), "no geom away"),
        (
            '<joint name="j" type="slide" range="0 1"/><geom name="toe" size="1"/>',
            JammedJoint(),
            "not a hinge",
        ),
        (
            '<joint name="j"/><frame pos="1 0 0"><geom name="toe" type="capsule" size="1 1"/></frame>',
            MissingShank(0.01),
            "<frame>",
        ),
        ('<joint name="k"/><geom name="claw" size="1"/>', JammedJoint(), "no joint 'j'"),
        ('<joint name="j"/><geom name="toe" size="1"/>', WeakMotor(), "no actuator"),
        ('<joint name="k"/><geom name="claw" size="1"/>', MissingShank(0.01), "no geom 'toe'"),
    ],
)
def test_a_limb_that_cannot_break_in_this_way_is_in_the_error(
    body: str, damage: DamageType, message: str
) -> None:
    spec = mujoco.MjSpec.from_string(f'<mujoco><worldbody><body name="b">{body}</body></worldbody></mujoco>')
    limb = Limb(name="only", body="b", joints=("j",), toe_geom="toe")
    with pytest.raises(ConfigError, match=message):
        damage.apply(spec, limb, 1.0)


def test_a_jammed_joint_stays_in_the_pose_of_the_mjcf() -> None:
    spec = limb(joint='ref="0.5"')
    JammedJoint(joint=1, range_deg=1.0).apply(spec, ONE, 1.0)
    model = spec.compile()
    assert model.joint("knee").range == pytest.approx([0.5 - math.radians(1), 0.5 + math.radians(1)])
    assert model.joint("knee").qpos0 == pytest.approx(0.5)


# qpos: the free joint, hip, knee, elbow.
HOME = '<keyframe><key name="home" qpos="0 0 1 1 0 0 0 0.1 -0.75 0.3"/><key name="flat"/></keyframe>'


@pytest.mark.parametrize("unit", ["radian", "degree"])
def test_a_joint_jams_in_the_default_pose_of_the_robot(unit: str) -> None:
    text = LIMB.format(end="", extra=HOME, joint="").replace("radian", unit)
    spec = mujoco.MjSpec.from_string(
        text.replace('range="-1 1"', 'range="-57 57"') if unit == "degree" else text
    )
    JammedJoint(joint=1, range_deg=1.0, at="default").apply(spec, replace(ONE, keyframe="home"), 1.0)
    model = spec.compile()
    assert model.joint("knee").range == pytest.approx([-0.75 - math.radians(1), -0.75 + math.radians(1)])


def test_without_positions_of_its_own_the_default_pose_is_the_reference_pose() -> None:
    for keyframe in (None, "flat"):
        spec = limb(extra=HOME, joint='ref="0.5"')
        JammedJoint(joint=1, range_deg=1.0, at="default").apply(spec, replace(ONE, keyframe=keyframe), 1.0)
        middle = spec.compile().joint("knee").range.mean()
        assert middle == pytest.approx(0.5)


def test_a_keyframe_that_does_not_exist_is_rejected() -> None:
    with pytest.raises(ConfigError, match=r"no keyframe 'stand'.*expected one of 'home', 'flat'"):
        JammedJoint(at="default").apply(limb(extra=HOME), replace(ONE, keyframe="stand"), 1.0)


def test_the_default_pose_is_the_keyframe_of_the_robot_toml() -> None:
    robot = load_robot("ant")
    spec = {**robot.spec, "reset": {**robot.spec["reset"], "keyframe": "home"}}
    assert {limb.keyframe for limb in replace(robot, spec=spec).limbs} == {"home"}
    assert {limb.keyframe for limb in robot.limbs} == {None}


def test_a_joint_is_selected_by_an_expression_in_its_name() -> None:
    robot = load_robot("hexapod")
    for number, limb_ in enumerate(robot.limbs):
        by_name = damaged(robot, JammedJoint(joint="femur"), number)
        by_index = damaged(robot, JammedJoint(joint=1), number)
        assert "femur" in limb_.joints[1]
        assert numeric_differences(by_name, by_index) == set()


def test_a_hinge_without_limits_receives_some() -> None:
    text = LIMB.format(end="", extra="<contact/>", joint="").replace(
        'axis="0 1 0" range="-1 1"', 'axis="0 1 0"'
    )
    sound, spec = mujoco.MjModel.from_xml_string(text), mujoco.MjSpec.from_string(text)
    JammedJoint(joint=1, range_deg=2.0, at=30).apply(spec, ONE, 0.75)
    model = spec.compile()
    assert not sound.joint("knee").limited
    assert model.joint("knee").limited
    # A quarter of ±180°, and three quarters of ±2°, around 30°.
    assert np.rad2deg(model.joint("knee").range) == pytest.approx([30 - 46.5, 30 + 46.5])
    assert numeric_differences(sound, model) == {"jnt_range", "jnt_limited"}


TENDON = """<tendon><fixed name="cord">
  <joint joint="knee" coef="0.5"/><joint joint="hip" coef="1"/></fixed></tendon>"""
ROPE = '<tendon><spatial name="rope"><site site="hub"/><site site="ankle"/></spatial></tendon>'
MOTORS = {
    "joint": '<actuator><motor joint="knee" gear="3"/></actuator>',
    "joint in the frame of its parent": '<actuator><motor jointinparent="knee" gear="3"/></actuator>',
    "fixed tendon": f'{TENDON}<actuator><position tendon="cord" kp="7" kv="1"/></actuator>',
    "servo with a damping ratio": '<actuator><position joint="knee" kp="7" dampratio="0.8"/></actuator>',
    "spatial tendon to the torso": f'{ROPE}<actuator><motor tendon="rope" gear="9"/></actuator>',
    "site": '<actuator><motor site="ankle" gear="1 2 3 0 0 0"/></actuator>',
    "site seen from the torso": (
        '<actuator><motor site="ankle" refsite="hub" gear="1 2 3 0 0 0"/></actuator>'
    ),
    "slider-crank": '<actuator><motor cranksite="ankle" slidersite="hub" cranklength="1"/></actuator>',
    "filtered": ('<actuator><general joint="knee" dyntype="filter" dynprm="0.1" gainprm="5"/></actuator>'),
}


@pytest.mark.parametrize("kind", MOTORS)
@pytest.mark.parametrize("joint", ["", 'actuatorfrcrange="-0.2 0.1"'])
def test_a_weak_motor_gives_its_share_by_whatever_it_moves_the_limb(kind: str, joint: str) -> None:
    spec = limb(extra=MOTORS[kind], joint=joint)
    WeakMotor(strength=0.25).apply(spec, ONE, 1.0)
    sound, weak = limb(extra=MOTORS[kind], joint=joint).compile(), spec.compile()
    rng = np.random.default_rng(0)
    for _ in range(20):
        state = rng.uniform(-0.5, 0.5, (4, sound.nv))
        forces = []
        for model in (sound, weak):
            data = mujoco.MjData(model)
            data.ctrl[:], data.act[:] = state[0, : model.nu], state[1, : model.na]
            data.qpos[7:], data.qvel[:] = state[2, 6:], state[3]
            mujoco.mj_forward(model, data)
            forces.append(data.qfrc_actuator.copy())
        assert np.any(forces[0] != 0)
        assert forces[1] == pytest.approx(0.25 * forces[0], rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("type_", [WeakMotor(strength=0.25, joint="knee"), WeakMotor(0.25, joint=1)])
def test_the_motor_of_one_joint_weakens_alone(type_: WeakMotor) -> None:
    cord = '<tendon><fixed name="cord"><joint joint="knee" coef="2"/></fixed></tendon>'
    motors = (
        f'{cord}<actuator><motor joint="hip" gear="2"/><motor joint="knee" gear="3"/>'
        '<position joint="elbow" kp="5"/><position tendon="cord" kp="7" forcerange="-2 2"/></actuator>'
    )
    spec = limb(extra=motors)
    type_.apply(spec, ONE, 1.0)
    forces = []
    for model in (limb(extra=motors).compile(), spec.compile()):
        data = mujoco.MjData(model)
        data.ctrl[:], data.qpos[7:] = [0.7, -0.4, 0.3, 0.2], [0.1, -0.2, 0.3]
        mujoco.mj_forward(model, data)
        forces.append(data.actuator_force.copy())
    assert forces[1] == pytest.approx(forces[0] * [1, 0.25, 1, 0.25], rel=1e-12)
    assert forces[0][3] == 2  # at its limit


def test_a_joint_without_a_motor_of_its_own_cannot_weaken_alone() -> None:
    pair = f'{TENDON}<actuator><motor name="pull" tendon="cord"/></actuator>'
    with pytest.raises(ConfigError, match="pull moves joint knee together with hip; leave out"):
        WeakMotor(joint="knee").apply(limb(extra=pair), ONE, 1.0)
    with pytest.raises(ConfigError, match="limb one: joint knee has no actuator"):
        DeadMotor(joint=1).apply(limb(extra='<actuator><motor joint="hip"/></actuator>'), ONE, 1.0)


def test_a_limb_with_dead_motors_moves_like_one_without_motors() -> None:
    motors = """<actuator><position joint="hip" kp="20" kv="1" forcerange="-9 9"/>
      <motor joint="knee" gear="3"/><position joint="elbow" kp="5"/></actuator>"""
    joint = 'damping="0.2" frictionloss="0.1" stiffness="0.5" armature="0.01"'
    spec = limb(extra=motors, joint=joint)
    DeadMotor().apply(spec, ONE, 1.0)
    without = '<actuator><position joint="elbow" kp="5"/></actuator>'
    models = (spec.compile(), limb(extra=without, joint=joint).compile())
    ends = []
    for model, ctrl in zip(models, ([0.5, -0.9, 0.3], [0.3]), strict=True):
        data = mujoco.MjData(model)
        data.ctrl[:] = ctrl
        mujoco.mj_step(model, data, nstep=200)
        ends.append(data.qpos.copy())
    assert ends[0] == pytest.approx(ends[1], rel=1e-12, abs=1e-12)


def test_a_motor_that_is_half_dead_is_a_weak_one() -> None:
    robot = load_robot("hexapod")
    dead, weak = (damaged(robot, type_, 2, 0.5) for type_ in (DeadMotor("tibia"), WeakMotor(0.0, "tibia")))
    assert numeric_differences(dead, weak) == set()
    half = damaged(robot, WeakMotor(0.5, 2), 2)
    assert numeric_differences(dead, half) == set()
    changed = np.flatnonzero(np.any(dead.actuator_gainprm != healthy(robot).actuator_gainprm, axis=1))
    assert [dead.actuator(int(index)).name for index in changed] == [robot.limbs[2].joints[2]]


def test_a_dead_motor_gives_nothing_whatever_its_limits() -> None:
    motor = '<motor joint="knee" gear="5" forcelimited="true" forcerange="-3 3"/>'
    limited = 'actuatorfrclimited="true" actuatorfrcrange="-2 2"'
    spec = limb(extra=f"<actuator>{motor}</actuator>", joint=limited)
    DeadMotor().apply(spec, ONE, 1.0)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[:] = 1.0
    mujoco.mj_forward(model, data)
    assert not data.qfrc_actuator.any()


@pytest.mark.parametrize(
    ("extra", "joint", "message"),
    [
        (
            '<tendon><fixed name="cord"><joint joint="knee" coef="1"/><joint joint="elbow"'
            ' coef="1"/></fixed></tendon>'
            '<actuator><motor name="pair" tendon="cord"/></actuator>',
            "",
            "actuator pair moves limb one together with body 'other'",
        ),
        (
            '<tendon><spatial name="rope"><site site="hand"/><site site="ankle"/></spatial></tendon>'
            '<actuator><motor name="pair" tendon="rope"/></actuator>',
            "",
            "actuator pair moves limb one together with body 'other'",
        ),
        ('<actuator><motor joint="elbow"/></actuator>', "", "limb one has no actuator"),
        ('<actuator><motor joint="knee"/></actuator>', 'actuatorgravcomp="true"', "compensate for gravity"),
    ],
)
def test_a_motor_that_cannot_weaken_alone_is_rejected(extra: str, joint: str, message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        WeakMotor().apply(limb(extra=extra, joint=joint), ONE, 1.0)


class Blocked(DamageType):
    """A type of tests; what makes it one that can be used is left to each."""

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        """Change the friction of a joint."""
        spec.joint(limb.joints[0]).frictionloss = severity


@pytest.fixture
def damage_types(monkeypatch: pytest.MonkeyPatch) -> dict[str, type[DamageType]]:
    """Return the known types, which a test may add to."""
    known = dict(DAMAGE_TYPES)
    monkeypatch.setattr(dappo_batch.damage, "DAMAGE_TYPES", known)
    return known


def rusty(name: object) -> type[DamageType]:
    @dataclass(frozen=True)
    class Rusty(Blocked):
        level: float = 1.0

    Rusty.name = name  # type: ignore[assignment]
    return Rusty


def test_a_registered_type_is_known_wherever_types_are_named(
    damage_types: dict[str, type[DamageType]],
) -> None:
    kind = rusty("rusty")
    assert register_damage_type(kind) is kind
    table = dappo_batch.compile_class_table("ant", types=["rusty"], max_damaged_limbs=1)
    assert [entry.name for entry in table.space.classes][1] == "rusty@0"
    joint = table.models[1].joint(table.robot.limbs[0].joints[0])
    assert table.models[1].dof_frictionloss[joint.dofadr[0]] == 1.0
    # A cell of a notebook that runs again defines the class again.
    again = rusty("rusty")
    register_damage_type(again)
    assert damage_types["rusty"] is again


def not_a_dataclass() -> object:
    return type("Plain", (Blocked,), {"name": "plain"})


def not_frozen() -> object:
    return dataclass(type("Soft", (Blocked,), {"name": "soft"}))


def abstract() -> object:
    return dataclass(frozen=True)(type("Idle", (DamageType,), {"name": "idle"}))


def nameless() -> object:
    return dataclass(frozen=True)(type("Nameless", (Blocked,), {}))


@pytest.mark.usefixtures("damage_types")
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: 5, "a class derived from DamageType, got 5"),
        (lambda: dict, "a class derived from DamageType"),
        (lambda: JammedJoint(), "a class derived from DamageType"),
        (not_a_dataclass, "Plain must be a dataclass"),
        (not_frozen, "Soft must be a dataclass: write @dataclass\\(frozen=True\\)"),
        (abstract, "Idle must define apply"),
        (nameless, "Nameless must have a name of lower-case letters.*got None"),
        (lambda: rusty("Rusty Joint"), "got 'Rusty Joint'"),
        (lambda: rusty("a@b"), "got 'a@b'"),
        (
            lambda: rusty("types"),
            "other than max_damaged_limbs, max_damages_per_limb, modules, severity, types, got 'types'",
        ),
        (
            lambda: rusty("jammed_joint"),
            "'jammed_joint' belongs to dappo_batch.damage.jammed_joint.JammedJoint",
        ),
    ],
)
def test_what_cannot_be_a_damage_type_is_rejected(make: Callable[[], type[DamageType]], message: str) -> None:
    before = dict(dappo_batch.damage.DAMAGE_TYPES)
    with pytest.raises(ConfigError, match=message):
        register_damage_type(make())
    assert before == dappo_batch.damage.DAMAGE_TYPES


OWN_TYPE = """
from dataclasses import dataclass
from typing import ClassVar

import dappo_batch


@dappo_batch.register_damage_type
@dataclass(frozen=True)
class StiffJoints(dappo_batch.DamageType):
    stiffness: float = 3.0
    name: ClassVar[str] = "stiff_joints"

    def apply(self, spec, limb, severity):
        for name in limb.joints:
            spec.joint(name).stiffness[0] = severity * self.stiffness
"""


def test_damage_types_of_a_users_module_work_in_every_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "stiff.py").write_text(OWN_TYPE)
    robot = load_robot("ant")
    text = robot.toml_text.replace(
        'types = ["jammed_joint", "missing_toe"]', 'types = ["stiff_joints"]\nmodules = ["stiff"]'
    )
    (tmp_path / "ant.toml").write_text(text)
    (tmp_path / "ant.xml").write_bytes(robot.mjcf_path.read_bytes())
    settings = [
        "--envs",
        "4",
        "--steps",
        "512",
        "--set",
        "horizon=64",
        "ppo.hidden=[8]",
        "evaluation.episodes=1",
    ]
    own, set_ = tmp_path / "own", tmp_path / "set"
    commands = [
        ["check", "ant.toml"],
        ["classes", "--robot", "ant.toml"],
        ["train", "--robot", "ant.toml", *settings, "--run", str(own)],
        ["evaluate", str(own)],
        # By the configuration, on a robot of the package.
        [
            "train",
            "--robot",
            "ant",
            *settings,
            'damage.types=["stiff_joints"]',
            'damage.modules=["stiff"]',
            "--run",
            str(set_),
        ],
        ["evaluate", str(set_)],
    ]
    outputs = [run_in(tmp_path, *command) for command in commands]
    assert all("stiff_joints@3" in output for output in outputs[1::2])
    (tmp_path / "stiff.py").unlink()
    assert "cannot import the module 'stiff'" in run_in(tmp_path, "evaluate", str(own), code=1)


def run_in(folder: Path, *arguments: str, code: int = 0) -> str:
    """Run the command line in a folder, in a process without the types of this one."""
    done = subprocess.run(
        [sys.executable, "-m", "dappo_batch", *arguments],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == code, done.stderr
    return done.stdout + done.stderr
