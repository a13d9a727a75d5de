"""The lane engine refuses every robot that it does not support, with the exact reason."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
import pytest

import dappo_batch
from dappo_batch import ClassTable, ConfigError
from dappo_batch.damage import DAMAGE_TYPES, DamageType
from dappo_batch.robots import Limb

ROBOTS = Path(__file__).parent / "robots"
Edits = tuple[tuple[str, str], ...]

# The toy robot stands on a cylinder, which the lane engine does not support; a ball it does.
BALL: Edits = (('type="cylinder" size="0.12 0.02"', 'name="ball" type="sphere" size="0.05"'),)
FLOOR = '<geom type="plane" size="10 10 1"'
PLATE = '<body name="plate" pos="0 0 0.17">'
KNEE = '<joint name="north_knee" axis="0 1 0"/>'
FREE = "<freejoint/>"
DEFAULT_GEOM = '<geom type="capsule" conaffinity="0"'
OPTION = '<option timestep="0.005" integrator="implicitfast"/>'
ACTUATORS = "</actuator>"
SENSORS = "</sensor>"
WORLD = "</worldbody>"
END = "</mujoco>"


def toy(folder: Path, edits: Edits, toml: Edits = ()) -> ClassTable:
    """Compile the healthy toy robot after some edits of its MJCF and its TOML, each found exactly once."""
    for name, changes in (("tripod.xml", edits), ("tripod.toml", toml)):
        text = (ROBOTS / name).read_text()
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        (folder / name).write_text(text)
    return dappo_batch.compile_class_table(folder / "tripod.toml", max_damaged_limbs=0)


def option(text: str) -> tuple[str, str]:
    return OPTION, OPTION.replace("/>", f" {text}/>")


def flag(text: str) -> tuple[str, str]:
    return OPTION, f"{OPTION.replace('/>', '>')}<flag {text}/></option>"


def joint(text: str) -> tuple[str, str]:
    return KNEE, KNEE.replace("/>", f" {text}/>")


def actuator(text: str) -> tuple[str, str]:
    return ACTUATORS, f"{text}{ACTUATORS}"


def sensor(text: str) -> tuple[str, str]:
    return SENSORS, f"{text}{SENSORS}"


NO_MASKS = (DEFAULT_GEOM, f'{DEFAULT_GEOM} contype="0"')
NAMED_FLOOR = (f'{FLOOR} conaffinity="1"', f'{FLOOR} name="floor"')
NO_KNEE_SERVO = ('<position name="north_knee" joint="north_knee"/>', "")


def pair(text: str) -> Edits:
    """Replace all contacts by one explicit pair."""
    contact = f'<contact><pair geom1="floor" geom2="north_toe" {text}/></contact>'
    return (NO_MASKS, NAMED_FLOOR, (END, contact + END))


# What is changed in the robot, and what the refusal must say.
REFUSALS: dict[str, tuple[Edits, str]] = {
    # Shape.
    "slide joint": ((joint('type="slide"'),), "joint `north_knee` is not a hinge"),
    "ball joint": (
        ((KNEE, '<joint name="north_knee" type="ball" range="0 0.6"/>'), NO_KNEE_SERVO),
        "is not a hinge",
    ),
    "two joints a body": (
        ((KNEE, f'{KNEE}<joint axis="0 0 1"/>'),),
        "body `north_lower` moves by 2 joints",
    ),
    "branching limb": (
        ((KNEE, f'{KNEE}<geom size="0.02 0.02"/></body><body name="fork"><joint axis="0 1 0"/>'),),
        "a limb branches: body `north_lower` and body `fork`",
    ),
    "limb of another length": (
        ((KNEE, f'{KNEE}<body name="claw"><joint axis="0 1 0"/><geom size="0.02 0.02"/></body>'),),
        "limbs of equal length",
    ),
    "body next to the robot": (
        ((WORLD, f'<body name="door"><joint/><geom type="sphere" size="0.1"/></body>{WORLD}'),),
        "body `door` does not hang on a free body",
    ),
    "second free body": (
        ((WORLD, f'<body name="ball" pos="2 0 1"><freejoint/><geom size="0.1 0.1"/></body>{WORLD}'),),
        "body `ball` is a second free body",
    ),
    # Contacts.
    "self-collision": (
        ((DEFAULT_GEOM, '<geom type="capsule"'),),
        "touch each other by contype and conaffinity",
    ),
    "tilted floor": (((FLOOR, f'{FLOOR} euler="0.1 0 0"'),), "is not level"),
    "floor in a body": (
        (
            (f'{FLOOR} conaffinity="1" friction="1 0.005 0.0001" solref="0.01 1" solmix="2"/>', ""),
            (PLATE, f'<body name="ground">{FLOOR} conaffinity="1"/></body>{PLATE}'),
        ),
        "is not with a plane of the world body",
    ),
    "two floors": (((PLATE, f'{FLOOR} pos="0 0 -1" conaffinity="1"/>{PLATE}'),), "are two floors"),
    "no contact": ((NO_MASKS, (f'{FLOOR} conaffinity="1"', FLOOR)), "no geom can touch a floor"),
    "rolling friction": (((FLOOR, f'{FLOOR} condim="6"'),), "has condim 6"),
    "friction with a direction": (pair('friction="1 0.5 0.1 0.1 0.1"'), "not the same in both directions"),
    "contact between limbs": (
        (
            NO_MASKS,
            NAMED_FLOOR,
            (END, f'<contact><pair geom1="west_toe" geom2="north_toe"/></contact>{END}'),
        ),
        "the contact of geom `north_toe` and geom `west_toe` is not with a plane",
    ),
    "contact gap": (pair('gap="0.01"'), "has a gap (pair_gap = 0.01)"),
    "softness of friction": (pair('solreffriction="0.03 1"'), "has a softness of its own for friction"),
    "contacts of two softnesses": (
        (('name="north_toe"', 'name="north_toe" solref="0.05 1"'),),
        "differ in solref or solimp",
    ),
    "steep impedance": (
        ((FLOOR, f'{FLOOR} priority="1" solimp="0.9 0.95 0.001 0.5 6"'),),
        "power of solimp is 6",
    ),
    "mixed solref": (pair('solref="0.02 -1"'), "mixes its two formats"),
    # Joints.
    "friction loss": (
        (joint('frictionloss="0.1"'),),
        "joint `north_knee` has friction loss (dof_frictionloss = 0.1)",
    ),
    "spring": ((joint('stiffness="3"'),), "joint `north_knee` has a spring (jnt_stiffness = 3)"),
    "force limit": (
        (joint('actuatorfrcrange="-1 1"'),),
        "joint `north_knee` has a limit of its actuators' force",
    ),
    "limits of two softnesses": (
        (joint('solreflimit="0.05 1"'),),
        "the limits of joint `north_lift` and joint",
    ),
    "overlapping margins": ((joint('margin="0.6"'),), "joint `north_knee` is always near both limits"),
    "damped root": (((FREE, '<joint type="free" armature="0"/>'),), "has damping 0.5, expected 0"),
    "heavy root": (((FREE, '<joint type="free" damping="0"/>'),), "has armature 0.01, expected 0"),
    # Actuators.
    "two on a joint": (
        (actuator('<motor name="second" joint="west_lift"/>'),),
        "actuator `west_lift` and actuator `second` move the same joint",
    ),
    "motor of the root": (
        ((FREE, '<freejoint name="root"/>'), actuator('<motor name="jet" joint="root"/>')),
        "actuator `jet` moves the free joint",
    ),
    "filtered control": (
        (NO_KNEE_SERVO, actuator('<general name="slow" joint="north_knee" dyntype="filter" dynprm="0.1"/>')),
        "actuator activations",
    ),
    "affine gain": (
        (NO_KNEE_SERVO, actuator('<general name="m" joint="north_knee" gaintype="affine"/>')),
        "actuator `m` has a gain other than a fixed one (actuator_gaintype = 1)",
    ),
    "bias of another program": (
        (
            NO_KNEE_SERVO,
            actuator('<general name="m" joint="north_knee" biastype="user"/>'),
        ),
        "actuator `m` has a bias other than an affine one",
    ),
    "in the parent's frame": (
        (NO_KNEE_SERVO, actuator('<motor name="m" jointinparent="north_knee"/>')),
        "actuator `m` has a transmission other than a joint",
    ),
    "gear in space": (
        (NO_KNEE_SERVO, actuator('<motor name="m" joint="north_knee" gear="1 0 2"/>')),
        "actuator `m` has gear [1.0, 0.0, 2.0",
    ),
    # Sensors.
    "gyroscope": (
        ((SENSORS, f'<gyro name="gyro" site="north_site"/>{SENSORS}'),),
        "sensor `gyro` has a reading other than touch",
    ),
    "cutoff": (
        (('<touch name="west_touch"', '<touch name="west_touch" cutoff="5"'),),
        "sensor `west_touch` has a cutoff (sensor_cutoff = 5)",
    ),
    "two sensors a body": ((sensor('<touch name="twin" site="west_site"/>'),), "sensor `twin` is the second"),
    "thin sensor": (
        (('<site name="east_site"', '<site name="east_site" size="0.02 0.08"'),),
        "the site of sensor `east_touch` does not enclose",
    ),
    "short sensor": (
        (('<site name="east_site"', '<site name="east_site" size="0.03 0.05"'),),
        "the site of sensor `east_touch` does not enclose",
    ),
    "square sensor": (
        (('<site name="east_site"', '<site name="east_site" type="box" size="1 1 1"'),),
        "the site of sensor `east_touch` does not enclose",
    ),
    # The world.
    "equality": (
        ((END, f'<equality><joint joint1="west_lift" joint2="east_lift"/></equality>{END}'),),
        "the model has equality constraints (neq = 1)",
    ),
    "tendon": (
        ((END, f'<tendon><fixed><joint joint="west_lift" coef="1"/></fixed></tendon>{END}'),),
        "the model has tendons (ntendon = 1)",
    ),
    "mocap body": (((PLATE, f'<body name="hand" mocap="true"/>{PLATE}'),), "the model has mocap bodies"),
    "gravity compensation": (
        (('<body name="west_lower"', '<body name="west_lower" gravcomp="0.5"'),),
        "body `west_lower` has gravity compensation (body_gravcomp = 0.5)",
    ),
    "water": ((option('density="1000"'),), "a fluid's density (opt.density = 1000)"),
    "honey": ((option('viscosity="2"'),), "a fluid's viscosity (opt.viscosity = 2)"),
    "wind": ((option('wind="0 3 0"'),), "wind (opt.wind = 3)"),
    "slope": ((option('gravity="1 0 -9.81"'),), "not along z"),
    # The solver.
    "elliptic cones": ((option('cone="elliptic"'),), "elliptic friction cones (opt.cone = 1)"),
    "conjugate gradients": ((option('solver="CG"'),), "Newton's method alone"),
    "no-slip solver": ((option('noslip_iterations="3"'),), "a no-slip solver"),
    "impedance ratio": ((option('impratio="10"'),), "opt.impratio is 10"),
    "few iterations": ((option('iterations="1"'),), "opt.iterations is 1"),
    "another integrator": (((OPTION, OPTION.replace("fast", "")),), "opt.integrator is 2"),
    "energy": ((flag('energy="enable"'),), "special features switched on"),
    "no damping": ((flag('damper="disable"'),), "opt.disableflags switches parts of MuJoCo off"),
}


def refusal(table: ClassTable) -> str:
    with pytest.raises(ConfigError, match="the lane engine cannot simulate this robot: ") as caught:
        dappo_batch.make_vec(table, backend="lanes")
    return str(caught.value)


@pytest.mark.parametrize("name", REFUSALS)
def test_a_robot_with_something_unknown_is_rejected_with_the_reason(name: str, tmp_path: Path) -> None:
    edits, reason = REFUSALS[name]
    table = toy(tmp_path, BALL + edits)
    assert reason in refusal(table)
    envs = dappo_batch.make_vec(table)
    assert (envs.backend, envs.precision) == ("mujoco", "f64")
    assert reason in envs.backend_note
    envs.close()


def test_the_toy_robot_stands_on_a_shape_that_is_unknown(tmp_path: Path) -> None:
    reason = "geom `geom 1` can touch the floor but is not a sphere, capsule or box"
    assert reason in refusal(toy(tmp_path, ()))


def test_without_its_cylinder_the_toy_robot_is_known(tmp_path: Path) -> None:
    envs = dappo_batch.make_vec(toy(tmp_path, BALL))
    assert (envs.backend, envs.backend_note) == ("lanes", "")


@pytest.mark.parametrize(
    "bodies",
    ['body1="plate" body2="north"', 'body1="north" body2="north_lower"', 'body1="north" body2="west"'],
)
def test_an_exclusion_of_contacts_that_cannot_be_leaves_the_robot_known(bodies: str, tmp_path: Path) -> None:
    envs = dappo_batch.make_vec(toy(tmp_path, (*BALL, (END, f"<contact><exclude {bodies}/></contact>{END}"))))
    assert (envs.backend, envs.backend_note) == ("lanes", "")


def test_an_exclusion_between_a_limb_and_the_floor_is_not_ignored(tmp_path: Path) -> None:
    exclude = '<contact><exclude body1="world" body2="north_lower"/></contact>'
    assert "touch each other by contype and conaffinity" in refusal(
        toy(tmp_path, (*BALL, (END, exclude + END)))
    )


def test_a_velocity_that_is_not_the_roots_is_rejected(tmp_path: Path) -> None:
    table = toy(tmp_path, BALL, toml=(('main_body = "plate"', 'main_body = "west_lower"'),))
    assert "main_body, body `west_lower`, is not body `plate`" in refusal(table)


@dataclass(frozen=True)
class StiffJoint(DamageType):
    """Damage that adds what the healthy robot does not have."""

    name: ClassVar[str] = "stiff_joint"

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        spec.joint(limb.joints[0]).frictionloss = severity


def test_a_damage_class_with_something_unknown_is_in_the_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    toy(tmp_path, BALL)
    monkeypatch.setitem(DAMAGE_TYPES, StiffJoint.name, StiffJoint)
    table = dappo_batch.compile_class_table(
        tmp_path / "tripod.toml", types=["stiff_joint"], max_damaged_limbs=1
    )
    assert "in damage class 1, joint `north_lift` has friction loss" in refusal(table)


def test_a_robot_that_touches_a_known_floor_at_any_height_is_known(tmp_path: Path) -> None:
    shutil.copy(ROBOTS / "tripod.toml", tmp_path)
    table = toy(tmp_path, (*BALL, (FLOOR, f'{FLOOR} pos="0 0 -0.5"')))
    envs = dappo_batch.make_vec(table, damage="healthy", seed=0)
    assert envs.backend == "lanes"
    envs.reset()
    for _ in range(100):
        _, _, terminated, _, _ = envs.step(np.zeros((1, 6), dtype=np.float32))
        if terminated.any():
            break
    assert terminated.any(), "the robot should have fallen below its allowed height"
