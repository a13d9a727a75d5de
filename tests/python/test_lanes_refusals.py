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

# The toy robot has a tendon with a spring, which the lane engine does not support; a slack one it does.
SLACK: Edits = (('stiffness="0.1"', ""),)
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
MESH = '<mesh name="hull" vertex="0.1 0 0  -0.1 0.1 0  -0.1 -0.1 0  0 0 0.04"/>'


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


def fork(limb: str) -> tuple[str, str]:
    """Hang a second lower part on a limb."""
    joint = f'<joint name="{limb}_knee" axis="0 1 0"/>'
    return joint, f'{joint}<geom size="0.02 0.02"/></body><body><joint axis="0 1 0"/>'


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
    "slide joint next to a hinge": (
        ((KNEE, f'{KNEE}<joint name="piston" type="slide" axis="0 0 1"/>'),),
        "joint `piston` is not a hinge",
    ),
    "two limbs that branch": (
        (fork("north"), fork("west")),
        "its limbs branch at body `north` and at body `west`, neither of which carries the other",
    ),
    "trunk of many joints": (
        (
            fork("north"),
            ('<joint name="north_lift"', 3 * '<joint axis="1 0 0"/>' + '<joint name="north_lift"'),
        ),
        "it has a trunk of 4 joints and 4 other limbs of up to 2",
    ),
    "limb of many joints": (
        (
            (
                KNEE,
                KNEE + '<body><joint axis="0 1 0"/><geom size="0.02 0.02"/>' * 6 + "</body>" * 6,
            ),
        ),
        "3 limbs of up to 8 joints",
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
        "geom 1 of body `plate` and geom 2 of body `north` touch each other by contype and conaffinity",
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
    "mesh": (
        (
            ("<worldbody>", f"<asset>{MESH}</asset><worldbody>"),
            ('type="cylinder" size="0.12 0.02"', 'name="hull" type="mesh" mesh="hull"'),
        ),
        "geom `hull` can touch the floor but is not a sphere, capsule, cylinder, ellipsoid or box",
    ),
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
    "odd impedance": (
        ((FLOOR, f'{FLOOR} priority="1" solimp="0.9 0.95 0.001 0.5 2.5"'),),
        "power of solimp is 2.5",
    ),
    "mixed solref": (pair('solref="0.02 -1"'), "mixes its two formats"),
    # Joints.
    "overlapping margins": ((joint('margin="0.6"'),), "joint `north_knee` is always near both limits"),
    "friction of the root": (
        ((FREE, '<joint type="free" frictionloss="0.1" armature="0" damping="0"/>'),),
        "joint 0, the free one, has friction loss 0.1",
    ),
    "spring of the root": (((FREE, '<joint type="free" stiffness="2"/>'),), "the free one, has stiffness 2"),
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
    "cutoff": (
        (('<touch name="west_touch"', '<touch name="west_touch" cutoff="5"'),),
        "sensor `west_touch` has a cutoff (sensor_cutoff = 5)",
    ),
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
        "equality 0 has an equality constraint (eq_active0 = 1)",
    ),
    "elastic tendon": (
        (('<fixed name="belt" ', '<fixed name="belt" stiffness="3" '),),
        "tendon `belt` has a spring (tendon_stiffness = 3)",
    ),
    "mocap body": (((PLATE, f'<body name="hand" mocap="true"/>{PLATE}'),), "the model has mocap bodies"),
    "water": ((option('density="1000"'),), "a fluid's density (opt.density = 1000)"),
    "honey": ((option('viscosity="2"'),), "a fluid's viscosity (opt.viscosity = 2)"),
    "wind": ((option('wind="0 3 0"'),), "wind (opt.wind = 3)"),
    # The solver.
    "no-slip solver": ((option('noslip_iterations="3"'),), "a no-slip solver"),
    "another integrator": (((OPTION, OPTION.replace("fast", "")),), "opt.integrator is 2"),
    "override": ((flag('override="enable"'),), "special features switched on (opt.enableflags = 0x1)"),
    "no damping": ((flag('damper="disable"'),), "opt.disableflags switches parts of MuJoCo off"),
}


def refusal(table: ClassTable) -> str:
    with pytest.raises(ConfigError, match="the lane engine cannot simulate this robot: ") as caught:
        dappo_batch.make_vec(table, backend="lanes")
    return str(caught.value)


@pytest.mark.parametrize("name", REFUSALS)
def test_a_robot_with_something_unknown_is_rejected_with_the_reason(name: str, tmp_path: Path) -> None:
    edits, reason = REFUSALS[name]
    table = toy(tmp_path, SLACK + edits)
    assert reason in refusal(table)
    envs = dappo_batch.make_vec(table)
    assert (envs.backend, envs.precision) == ("mujoco", "f64")
    assert reason in envs.backend_note
    envs.close()


def test_every_reason_is_in_the_refusal(tmp_path: Path) -> None:
    message = refusal(toy(tmp_path, (option('density="1.2" noslip_iterations="3"'), *REFUSALS["mesh"][0])))
    for reason in (
        "a fluid's density",
        "a no-slip solver",
        "tendon `belt` has a spring",
        "geom `hull` can touch the floor",
    ):
        assert reason in message


def test_reasons_of_one_kind_are_counted(tmp_path: Path) -> None:
    table = toy(tmp_path, (*SLACK, ('<joint armature="0.01" ', '<joint stiffness="1 0 2" armature="0.01" ')))
    assert "joint `north_lift` and 5 more have a nonlinear spring" in refusal(table)


# What does not matter, or what the engine solves more accurately than requested.
KNOWN: dict[str, tuple[Edits, str]] = {
    "the robot itself": ((), ""),
    "gyroscope": ((sensor('<gyro name="gyro" site="north_site" cutoff="2"/>'),), ""),
    "second touch sensor": ((sensor('<touch name="twin" site="west_site"/>'),), ""),
    "camera, light and keyframe": (
        (
            (WORLD, f'<camera pos="0 0 2"/><light pos="0 0 2"/>{WORLD}'),
            (END, f'<keyframe><key name="home"/></keyframe>{END}'),
        ),
        "",
    ),
    "mesh that cannot collide": (
        (
            ("<worldbody>", f"<asset>{MESH}</asset><worldbody>"),
            (FREE, f'{FREE}<geom type="mesh" mesh="hull" contype="0" conaffinity="0" mass="0"/>'),
        ),
        "",
    ),
    "equality that is off": (
        ((END, f'<equality><joint joint1="west_lift" joint2="east_lift" active="false"/></equality>{END}'),),
        "",
    ),
    "energy": ((flag('energy="enable"'),), ""),
    "no warm start": ((flag('warmstart="disable"'),), ""),
    "few iterations": (
        (option('iterations="4" ls_iterations="5"'),),
        "to convergence, although opt.iterations is 4 and opt.ls_iterations is 5",
    ),
    "conjugate gradients": ((option('solver="CG"'),), "to convergence, although opt.solver is 1"),
}


@pytest.mark.parametrize("name", KNOWN)
def test_a_robot_with_what_does_not_matter_is_known(name: str, tmp_path: Path) -> None:
    edits, note = KNOWN[name]
    envs = dappo_batch.make_vec(toy(tmp_path, SLACK + edits))
    assert envs.backend == "lanes"
    assert note in envs.backend_note
    assert bool(note) == bool(envs.backend_note)
    envs.close()


@pytest.mark.parametrize(
    "bodies",
    ['body1="plate" body2="north"', 'body1="north" body2="north_lower"', 'body1="north" body2="west"'],
)
def test_an_exclusion_of_contacts_that_cannot_be_leaves_the_robot_known(bodies: str, tmp_path: Path) -> None:
    envs = dappo_batch.make_vec(
        toy(tmp_path, (*SLACK, (END, f"<contact><exclude {bodies}/></contact>{END}")))
    )
    assert (envs.backend, envs.backend_note) == ("lanes", "")


def test_an_exclusion_between_a_limb_and_the_floor_is_not_ignored(tmp_path: Path) -> None:
    exclude = '<contact><exclude body1="world" body2="north_lower"/></contact>'
    assert "touch each other by contype and conaffinity" in refusal(
        toy(tmp_path, (*SLACK, (END, exclude + END)))
    )


def test_a_velocity_that_is_not_the_roots_is_rejected(tmp_path: Path) -> None:
    table = toy(tmp_path, SLACK, toml=(('main_body = "plate"', 'main_body = "west_lower"'),))
    assert "main_body, body `west_lower`, is not body `plate`" in refusal(table)


@dataclass(frozen=True)
class StiffJoint(DamageType):
    """Damage that adds what the healthy robot does not have."""

    name: ClassVar[str] = "stiff_joint"

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        spec.joint(limb.joints[0]).stiffness[1] = severity


def test_a_damage_class_with_something_unknown_is_in_the_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    toy(tmp_path, SLACK)
    monkeypatch.setitem(DAMAGE_TYPES, StiffJoint.name, StiffJoint)
    table = dappo_batch.compile_class_table(
        tmp_path / "tripod.toml", types=["stiff_joint"], max_damaged_limbs=1
    )
    assert "in damage class 1, joint `north_lift` has a nonlinear spring" in refusal(table)


def test_a_robot_that_touches_a_known_floor_at_any_height_is_known(tmp_path: Path) -> None:
    shutil.copy(ROBOTS / "tripod.toml", tmp_path)
    table = toy(tmp_path, (*SLACK, (FLOOR, f'{FLOOR} pos="0 0 -0.5"')))
    envs = dappo_batch.make_vec(table, damage="healthy", seed=0)
    assert envs.backend == "lanes"
    envs.reset()
    for _ in range(100):
        _, _, terminated, _, _ = envs.step(np.zeros((1, 6), dtype=np.float32))
        if terminated.any():
            break
    assert terminated.any(), "the robot should have fallen below its allowed height"
