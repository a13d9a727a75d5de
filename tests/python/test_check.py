"""`check` reports what a robot is, and which backend and damage types it supports."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
import pytest
from PIL import Image

import dappo_batch
from dappo_batch import ConfigError
from dappo_batch.damage import DAMAGE_TYPES, DamageType
from dappo_batch.model import lanes
from dappo_batch.render import tiles
from dappo_batch.results import JointInfo, RobotReport
from dappo_batch.robots import Limb

from .command_line import dappo_batch as run
from .test_simplify import FREE, OPTION, ROBOTS, SERVO, TOUCHES_ITSELF, Edits, write

SLACK: Edits = (('stiffness="0.1"', ""),)
"""Instead of the elastic belt, which the lane engine does not support."""


def test_numbers_of_a_report_are_those_of_mujoco() -> None:
    report = dappo_batch.check_robot(ROBOTS / "tripod.toml", max_damaged_limbs=1)
    model = mujoco.MjModel.from_xml_path(str(ROBOTS / "tripod.xml"))
    # The masses in the MJCF and the volumes of the capsules; 400 kg/m³.
    thigh = 400 * np.pi * 0.02**2 * (0.12 + 4 / 3 * 0.02)
    assert report.mass == pytest.approx(1 + 3 * (0.1 + thigh), rel=1e-9)
    assert report.mass == pytest.approx(model.body_subtreemass[0], rel=1e-12)
    assert (report.robot, report.timestep, report.frame_skip) == ("tripod", 0.005, 4)
    assert (report.integrator, report.cone) == ("implicitfast", "pyramidal")
    assert [joint.name for joint in report.joints] == [
        f"{limb}_{joint}" for limb in ("north", "west", "east") for joint in ("lift", "knee")
    ]
    assert report.joints[1] == JointInfo("north_knee", "hinge", (-0.6, 0.6), 0.5, 0.01, 0.0, 0.0)
    actuator = report.actuators[1]
    assert (actuator.name, actuator.control, actuator.kp, actuator.kd) == ("north_knee", "position", 15, 0)
    assert (actuator.gear, actuator.ctrl_range, actuator.force_range) == (1, (-0.5, 0.5), None)
    assert report.floor_contacts[:3] == ("a geom of plate", "a geom of north", "north_toe")
    assert not report.self_collision
    assert report.damage_classes[:3] == ("healthy", "missing_toe@0", "jammed_joint@0")
    assert len(report.damage_classes) == 7
    assert (report.edits, report.refusals) == ((), ())


def test_kinds_of_actuators_are_those_of_the_mjcf(tmp_path: Path) -> None:
    kinds = {
        "motor": ("torque", 0.0, 0.0),
        'position kp="3" kv="0.5"': ("position", 3.0, 0.5),
        'velocity kv="2"': ("velocity", 0.0, 2.0),
        'damper kv="2" ctrlrange="0 1"': ("other", 0.0, 0.0),
    }
    for kind, expected in kinds.items():
        path = write(tmp_path, ((SERVO, f'<{kind} joint="north_knee" forcerange="-2 1"/>'),))
        actuator = dappo_batch.check_robot(path, max_damaged_limbs=0).actuators[1]
        assert (actuator.control, actuator.kp, actuator.kd) == expected
        # Without a name it is called after its joint.
        assert (actuator.name, actuator.force_range) == ("north_knee", (-2.0, 1.0))


def test_contacts_are_those_that_simulations_have(tmp_path: Path) -> None:
    path = write(tmp_path, TOUCHES_ITSELF)
    report = dappo_batch.check_robot(path, max_damaged_limbs=0)
    assert report.self_collision
    assert len(report.floor_contacts) == 7
    path = write(tmp_path, TOUCHES_ITSELF, '[simplify]\nfloor_contacts = ["north_toe", "west_lower"]')
    report = dappo_batch.check_robot(path, max_damaged_limbs=0)
    assert not report.self_collision
    assert report.floor_contacts == ("north_toe", "west_toe")
    assert len(report.edits) == 2


# Edits of a robot on lanes, and the remedy in its TOML.
REMEDIES: dict[str, tuple[Edits, str]] = {
    "self-collision": (TOUCHES_ITSELF, "[simplify] self_collision = false"),
    "integrator": (
        ((OPTION, OPTION.replace("implicitfast", "implicit")),),
        '[simplify] integrator = "implicitfast"',
    ),
    "friction of the root": (
        ((FREE, '<joint name="root" type="free" frictionloss="0.1"/>'),),
        "[[override]] joints = 'root', frictionloss = 0",
    ),
    "nonlinear springs": (
        (("<joint armature", '<joint stiffness="1 0 2" armature'),),
        "[[override]] joints = '.*', stiffness = 0",
    ),
}


@pytest.mark.parametrize("name", REMEDIES)
def test_a_reason_against_lanes_has_a_remedy_that_removes_it(name: str, tmp_path: Path) -> None:
    mjcf, remedy = REMEDIES[name]
    report = dappo_batch.check_robot(write(tmp_path, SLACK + mjcf), max_damaged_limbs=0)
    assert report.backend == "mujoco"
    assert [reason.remedy for reason in report.reasons] == [remedy]
    table, entry = remedy.split(" ", 1)
    toml = "\n".join([table, *entry.split(", ")])
    report = dappo_batch.check_robot(write(tmp_path, SLACK + mjcf, toml), max_damaged_limbs=0)
    assert (report.backend, report.reasons) == ("lanes", ())
    assert [edit.after for edit in report.edits] == [entry.rpartition(" = ")[2].strip('"')]


def test_the_reasons_are_those_with_which_the_backend_refuses_the_robot(tmp_path: Path) -> None:
    table = dappo_batch.compile_class_table(write(tmp_path, ()), max_damaged_limbs=0)
    (reason,), notes = lanes.support(table)
    assert "tendon `belt` has a spring" in reason.text
    assert (reason.remedy, notes) == ("", ())
    with pytest.raises(ConfigError) as caught:
        dappo_batch.make_vec(table, backend="lanes")
    assert reason.text in str(caught.value)
    assert lanes.support(dappo_batch.compile_class_table("ant", max_damaged_limbs=0)) == ((), ())


def test_options_that_lanes_does_not_follow_are_noted(tmp_path: Path) -> None:
    edits = (*SLACK, (OPTION, OPTION.replace("/>", ' iterations="1"/>')))
    report = dappo_batch.check_robot(write(tmp_path, edits), max_damaged_limbs=0)
    assert report.backend == "lanes"
    assert [("opt.iterations is 1" in note) for note in report.notes] == [True]


def test_damage_that_cannot_be_applied_does_not_prevent_the_report(tmp_path: Path) -> None:
    knees = [f'<joint name="{limb}_knee" axis="0 1 0"' for limb in ("north", "east")]
    path = write(tmp_path, (*SLACK, *((knee, f'{knee} range="0.1 0.6"') for knee in knees)))
    out, _ = run("check", path, "--max-damaged-limbs", "1", code=1)
    assert "damage that cannot be applied" in out
    assert out.count("jammed_joint: limb") == 2
    assert "backend auto on the CPU: lanes" in out
    report = dappo_batch.check_robot(path, max_damaged_limbs=1)
    for limb, refusal in zip(("north", "east"), report.refusals, strict=True):
        assert limb in refusal
    assert report.damage_classes == ("healthy", "missing_toe@0", "missing_toe@1", "missing_toe@2")
    run("check", path, "--types", "missing_toe", "--max-damaged-limbs", "1")


@dataclass(frozen=True)
class NegativeSize(DamageType):
    """Damage that MuJoCo's compiler refuses."""

    name: ClassVar[str] = "negative_size"

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        spec.geom(limb.toe_geom).size = [-severity, 0, 0]


def test_all_damage_classes_that_do_not_compile_are_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(DAMAGE_TYPES, NegativeSize.name, NegativeSize)
    report = dappo_batch.check_robot("ant", types=["negative_size"], max_damaged_limbs=1)
    (refusal,) = report.refusals
    assert "4 faults" in refusal
    assert all(f"negative_size@{limb} does not compile" in refusal for limb in range(4))
    assert report.damage_classes == ("healthy",)


def test_the_command_prints_what_the_function_returns() -> None:
    report = dappo_batch.check_robot("ant", max_damaged_limbs=1)
    out, _ = run("check", "ant", "--max-damaged-limbs", "1", "--json")
    assert RobotReport.from_dict(json.loads(out)).to_dict() == report.to_dict() == json.loads(out)
    out, _ = run("check", "ant", "--max-damaged-limbs", "1")
    assert out.startswith("ant: 0.91088 kg, 8 joints, 8 actuators, 9 damage classes\n")
    assert "physics step 0.01 s, 5 in an env step of 0.05 s, rk4, pyramidal cones\n" in out
    assert "backend auto on the CPU: lanes" in out


def test_changes_are_printed_a_line_each(tmp_path: Path) -> None:
    tables = '[simplify]\ntimestep = 0.004\n[[override]]\njoints = ".*_knee"\ndamping = 0.7'
    out, _ = run("check", write(tmp_path, tables=tables), "--max-damaged-limbs", "0")
    assert "\n  [simplify] timestep: 0.005 → 0.004\n" in out
    assert "\n  [[override]] 0 damping of north_knee, west_knee, east_knee: 0.5 → 0.7\n" in out


def test_geoms_without_a_name_are_counted(tmp_path: Path) -> None:
    second = '<geom type="sphere" size="0.03" pos="0 0 0.1"/><body name="north" euler'
    path = write(tmp_path, (('<body name="north" euler', second),))
    out, _ = run("check", path, "--max-damaged-limbs", "0")
    assert "\nfloor contacts: 2 geoms of plate, a geom of north, north_toe, a geom of west," in out


def test_a_robot_that_cannot_be_compiled_is_refused_with_all_faults(tmp_path: Path) -> None:
    path = write(tmp_path, tables='[simplify]\ncone = "round"\ntimestep = -1')
    _, err = run("check", path, code=1)
    assert '`cone` is "round"' in err
    assert "`timestep` is -1" in err


@pytest.mark.usefixtures("opengl")
def test_a_picture_has_a_tile_for_each_damage_class(tmp_path: Path) -> None:
    file = tmp_path / "classes.png"
    out, _ = run("check", "ant", "--max-damaged-limbs", "1", "--picture", file)
    assert f"{file}: 9 of 9 damage classes" in out
    with Image.open(file) as picture:
        pixels = np.asarray(picture.convert("RGB")).astype(int)
    # Three tiles of 320 by 240 in a row, 4 pixels apart.
    assert pixels.shape == (3 * 244 - 4, 3 * 324 - 4, 3)
    red = (pixels[..., 0] > 150) & (pixels[..., 1:] < 80).all(axis=2)
    tiles = [
        red[244 * row + 40 :, 324 * column :][:200, :320].sum() for row in range(3) for column in range(3)
    ]
    assert tiles[0] == 0
    # Order of classes: a jammed joint, then a missing toe of the same limb, of which less is left.
    assert all(jammed > missing > 0 for jammed, missing in zip(tiles[1::2], tiles[2::2], strict=True))


def test_a_picture_that_cannot_be_written_is_refused_before_the_robot_is_compiled(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"ends in '.gif', expected .png"):
        dappo_batch.check_robot("ant", picture=tmp_path / "a.gif")
    with pytest.raises(ConfigError, match="there is no folder"):
        dappo_batch.check_robot("ant", picture=tmp_path / "b" / "a.png")


@pytest.mark.usefixtures("opengl")
def test_no_more_tiles_are_drawn_than_the_output_says(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tiles, "MOST", 2)
    file = tmp_path / "classes.png"
    out, _ = run("check", "ant", "--max-damaged-limbs", "1", "--picture", file)
    assert f"{file}: 2 of 9 damage classes" in out
    with Image.open(file) as picture:
        assert picture.size == (2 * 324 - 4, 240)
