"""Copies of robots: one folder that MuJoCo makes the same of, and what sets two versions apart."""

from __future__ import annotations

import dataclasses
import json
import re
import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

import dappo_batch
from dappo_batch import CheckpointError, ConfigError
from dappo_batch.robots.copies import RobotCopy
from dappo_batch.robots.flatten import flatten

from .mesh_robot import png, tetrahedron, write_mesh_robot

HAT = '<worldbody><geom type="mesh" mesh="hat"/></worldbody>'
CUBE = " ".join(f'file{side}="red.png"' for side in ("right", "left", "up", "down", "front", "back"))

# MJCFs in files of their own; what MuJoCo finds in them, the copy must hold.
LAYOUTS: dict[str, dict[str, str]] = {
    "folders of meshes and textures": {
        "robot.xml": '<mujoco><compiler meshdir="a" texturedir="b"/><asset><mesh file="hat.obj"/>'
        f'<texture type="2d" file="red.png"/></asset>{HAT}</mujoco>',
        "a/hat.obj": tetrahedron(),
        "b/red.png": "",
    },
    "one folder for both, but for meshes": {
        "robot.xml": '<mujoco><compiler assetdir="b" meshdir="a"/><asset><mesh file="hat.obj"/>'
        f'<texture name="t" type="cube" {CUBE}/></asset>{HAT}</mujoco>',
        "a/hat.obj": tetrahedron(),
        "b/red.png": "",
    },
    "the last folder holds": {
        "robot.xml": '<mujoco><compiler meshdir="a"/><include file="sub/more.xml"/><asset>'
        f'<mesh file="hat.obj"/></asset>{HAT}</mujoco>',
        "sub/more.xml": '<mujoco><compiler meshdir="c"/></mujoco>',
        "a/hat.obj": tetrahedron(),
        "c/hat.obj": tetrahedron(0.2),
    },
    "next to the file that includes": {
        "robot.xml": f'<mujoco><compiler meshdir="a"/><include file="sub/more.xml"/>{HAT}</mujoco>',
        "sub/more.xml": '<mujoco><asset><mesh file="hat.obj"/></asset><include file="deep.xml"/></mujoco>',
        "sub/deep.xml": '<mujoco><default><geom density="300"/></default></mujoco>',
        "sub/hat.obj": tetrahedron(),
    },
    "the model's own folder comes first": {
        "robot.xml": f'<mujoco><include file="sub/more.xml"/>{HAT}</mujoco>',
        "sub/more.xml": '<mujoco><asset><mesh file="hat.obj"/></asset></mujoco>',
        "hat.obj": tetrahedron(),
        "sub/hat.obj": tetrahedron(0.3),
    },
    "paths are stripped": {
        "robot.xml": '<mujoco><compiler meshdir="a" strippath="true"/><asset><mesh file="x/y/hat.obj"/>'
        f"</asset>{HAT}</mujoco>",
        "a/hat.obj": tetrahedron(),
    },
    "two files of one name": {
        "robot.xml": '<mujoco><asset><mesh file="a/hat.obj"/><mesh name="other" file="c/hat.obj"/></asset>'
        '<worldbody><geom type="mesh" mesh="hat"/><geom type="mesh" mesh="other"/></worldbody></mujoco>',
        "a/hat.obj": tetrahedron(),
        "c/hat.obj": tetrahedron(0.2),
    },
    "a model that is attached": {
        "robot.xml": '<mujoco><asset><model name="m" file="sub/leg.xml"/></asset>'
        '<worldbody><attach model="m" body="leg" prefix="x_"/></worldbody></mujoco>',
        "sub/leg.xml": '<mujoco model="leg"><compiler meshdir="own"/><asset><mesh name="hat" file="hat.obj"/>'
        '</asset><worldbody><body name="leg"><geom type="mesh" mesh="hat"/></body></worldbody></mujoco>',
        "sub/own/hat.obj": tetrahedron(0.2),
    },
    "included in the midst, and comments that XML forbids": {
        "robot.xml": "<mujoco><!-- ---- --><worldbody><body><joint/>"
        '<include file="part.xml"/></body></worldbody></mujoco>',
        "part.xml": '<mujocoinclude><!-- -- --><geom size="0.123456789012345"/></mujocoinclude>',
    },
}


def write(folder: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(png() if name.endswith(".png") else text.encode())
    return folder / "robot.xml"


def arrays(model: mujoco.MjModel) -> dict[str, np.ndarray]:
    """Return all arrays of a model but those about where files lie."""
    names = (name for name in dir(model) if not name.startswith("_") and "path" not in name)
    values = ((name, getattr(model, name)) for name in names)
    return {name: value for name, value in values if isinstance(value, np.ndarray)}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_the_copy_compiles_to_the_same_model_when_the_original_is_gone(layout: str, tmp_path: Path) -> None:
    original = write(tmp_path / "original", LAYOUTS[layout])
    expected = arrays(mujoco.MjModel.from_xml_path(str(original)))
    flattened = flatten(original)
    copy = tmp_path / "copy"
    copy.mkdir()
    (copy / "robot.xml").write_text(flattened.text)
    for name, text in flattened.documents.items():
        (copy / name).write_text(text)
    for name, path in flattened.assets.items():
        shutil.copy(path, copy / name)
    shutil.rmtree(tmp_path / "original")
    found = arrays(mujoco.MjModel.from_xml_path(str(copy / "robot.xml")))
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        np.testing.assert_array_equal(found[name], values, err_msg=name)
    assert all(path.parent == copy for path in copy.iterdir())


@pytest.mark.parametrize(
    ("files", "reason"),
    [
        (
            {"robot.xml": '<mujoco><include file="more.xml"/></mujoco>'},
            "'more.xml' of a <include> is missing",
        ),
        (
            {"robot.xml": '<mujoco><asset><mesh file="hat.obj"/></asset></mujoco>'},
            "'hat.obj' of a <mesh> is missing",
        ),
        ({"robot.xml": "<mujoco><worldbody></mujoco>"}, "robot.xml cannot be read: not valid XML"),
        ({"robot.xml": '<robot name="r"/>'}, "begins with <robot>, expected <mujoco>"),
    ],
)
def test_what_cannot_be_copied_is_rejected_by_name(
    files: dict[str, str], reason: str, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=re.escape(reason)):
        flatten(write(tmp_path, files))


@pytest.mark.parametrize("robot", ["ant", "hexapod"])
def test_a_built_in_robot_is_read_back_as_it_was_copied(robot: str, tmp_path: Path) -> None:
    copy = RobotCopy.of(robot, {})
    copy.check()
    for name, content in copy.to_write().items():
        (tmp_path / name).write_bytes(content)
    read = RobotCopy.read(tmp_path)
    assert read == copy
    assert copy.differences(read) == []
    assert dappo_batch.load_robot(tmp_path / "robot.toml").spec | {"mjcf": f"{robot}.xml"} == (
        dappo_batch.load_robot(robot).spec
    )


def test_everything_that_a_damage_code_means_is_recorded() -> None:
    section = {
        "types": ["weak_motor", "jammed_joint"],
        "severity": 0.5,
        "options": {"jammed_joint": {"joint": 1}},
    }
    assert RobotCopy.of("ant", section).damage == {
        "types": ["weak_motor", "jammed_joint"],
        "max_damaged_limbs": 2,
        "severity": 0.5,
        "weak_motor": {"strength": 0.5, "joint": None},
        "jammed_joint": {"joint": 1, "range_deg": 0.1, "at": "zero"},
    }


def test_a_record_without_parameters_that_were_added_later_is_still_valid(tmp_path: Path) -> None:
    copy = RobotCopy.of("ant", {})
    old = dataclasses.replace(copy, damage={**copy.damage, "jammed_joint": {"joint": 0, "range_deg": 0.1}})
    assert old.differences(copy) == []
    other = {**copy.damage, "jammed_joint": {"joint": 0, "range_deg": 0.1, "at": "default"}}
    (change,) = old.damage_changes(other)
    assert change.endswith('damage.jammed_joint.at: "zero" → "default"')


def edit(path: Path, old: str, new: str) -> None:
    text = path.read_text()
    assert text.count(old) == 1, old
    path.write_text(text.replace(old, new))


CHANGES: dict[str, tuple[str, str, str, str]] = {
    "gear": (
        "tripod.xml",
        'name="west_knee" joint="west_knee"/>',
        'name="west_knee" joint="west_knee" kp="9"/>',
        "kp",
    ),
    "mass": ("tripod.xml", 'size="0.12 0.02" mass="1"', 'size="0.12 0.02" mass="2"', 'mass="2"'),
    "an included file": (
        "parts/looks.xml",
        'name="red" texture',
        'name="red" rgba="1 0 0 1" texture',
        "rgba",
    ),
    "reward": (
        "tripod.toml",
        '"ctrl_squared", weight = -0.01',
        '"ctrl_squared", weight = -0.02',
        "reward.paper.terms[1].weight: -0.01 → -0.02",
    ),
    "time limit": ("tripod.toml", "steps = 200", "steps = 100", "max_episode_steps: 200 → 100"),
    "order of the limbs": (
        "tripod.toml",
        'name = "north"',
        'name = "nord"',
        'limbs[0].name: "north" → "nord"',
    ),
    "order of the damage types": (
        "tripod.toml",
        'types = ["missing_toe", "jammed_joint"]',
        'types = ["jammed_joint", "missing_toe"]',
        'damage.types: ["missing_toe", "jammed_joint"] → ["jammed_joint", "missing_toe"]',
    ),
    "a parameter of the damage": (
        "tripod.toml",
        "range_deg = 1.0",
        "range_deg = 2.0",
        "jammed_joint.range_deg",
    ),
    "a mesh": ("looks/shapes/hat.obj", "v 0 0 0.1", "v 0 0 0.2", "hat.obj: SHA-256 "),
}


@pytest.mark.parametrize("change", CHANGES)
def test_changes_are_reported_with_their_file(change: str, tmp_path: Path) -> None:
    file, old, new, expected = CHANGES[change]
    robot = write_mesh_robot(tmp_path / "robot")
    before = RobotCopy.of(robot, {})
    edit(tmp_path / "robot" / file, old, new)
    (difference,) = before.differences(RobotCopy.of(robot, {}))
    assert difference.startswith(Path(file).name if file.endswith((".toml", ".obj")) else f"{file}:")
    assert expected in difference


@pytest.mark.parametrize("name", ["flag.mjcf", "flag.xml", "flag"])
def test_a_change_of_an_attached_model_is_reported_with_its_file(name: str, tmp_path: Path) -> None:
    robot = write_mesh_robot(tmp_path / "robot")
    mjcf = tmp_path / "robot" / "tripod.xml"
    flag = tmp_path / "robot" / "parts" / name
    flag.write_text(
        '<mujoco model="flag"><worldbody><body name="flag"><geom size="0.01"/></body></worldbody></mujoco>'
    )
    edit(mjcf, "<worldbody>", f'<asset><model name="m" file="parts/{name}"/></asset><worldbody>')
    edit(
        mjcf,
        '<body name="north" euler="0 0 0">',
        '<frame><attach model="m" body="flag" prefix="x_"/></frame><body name="north" euler="0 0 0">',
    )
    before = RobotCopy.of(robot, {})
    assert before.differences(RobotCopy.of(robot, {})) == []
    edit(flag, 'size="0.01"', 'size="0.02"')
    (difference,) = before.differences(RobotCopy.of(robot, {}))
    assert difference.startswith(f"parts/{name}:")
    assert 'size="0.01"' in difference
    assert 'size="0.02"' in difference


def test_what_means_the_same_is_no_difference(tmp_path: Path) -> None:
    robot = write_mesh_robot(tmp_path / "one")
    before = RobotCopy.of(robot, {})
    mjcf = tmp_path / "one" / "tripod.xml"
    edit(mjcf, 'size="0.12 0.02" mass="1"', 'mass="1"   size="0.12  0.02"')
    mjcf.write_text("<!-- a remark -->\n" + mjcf.read_text().replace("\n  ", "\n    "))
    robot.write_text("# a remark\n" + robot.read_text())
    # The mesh lies elsewhere, and so does the robot.
    (tmp_path / "one" / "looks" / "shapes").rename(tmp_path / "one" / "looks" / "meshes")
    edit(tmp_path / "one" / "parts" / "looks.xml", "looks/shapes", "looks/meshes")
    moved = (tmp_path / "one").rename(tmp_path / "two") / "tripod.toml"
    assert before.differences(RobotCopy.of(moved, {})) == []


def test_a_copy_that_is_not_what_was_written_is_rejected_by_name(tmp_path: Path) -> None:
    copy = RobotCopy.of(write_mesh_robot(tmp_path / "robot"), {})

    def refusal(name: str, content: bytes | None) -> str:
        folder = tmp_path / "copy"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        for written, bytes_of in copy.to_write().items():
            (folder / written).write_bytes(bytes_of)
        (folder / name).unlink()
        if content is None:
            (folder / name).symlink_to("/dev/zero")
        else:
            (folder / name).write_bytes(content)
        with pytest.raises(CheckpointError) as caught:
            RobotCopy.read(folder)
        return str(caught.value)

    header = json.loads(copy.to_write()["robot.json"])
    assert "robot.toml: it has changed" in refusal("robot.toml", copy.files["robot.toml"][:-1])
    assert "robot.xml: it cannot be read (it has more than" in refusal(
        "robot.xml", copy.files["robot.xml"] + b" "
    )
    assert "robot-hat.obj: it cannot be read" in refusal("robot-hat.obj", None)
    assert "robot.json: it is truncated or foreign" in refusal("robot.json", b"{")
    foreign = {**header, "files": {"../../secret": {"bytes": 1, "sha256": ""}}}
    assert "lists '../../secret'" in refusal("robot.json", json.dumps(foreign).encode())
    assert "its format is 'other'" in refusal(
        "robot.json", json.dumps({**header, "format": "other"}).encode()
    )
    assert "robot.json: it is truncated or foreign" in refusal("robot.json", b"[" * 9000)
    for entry in ("origin", "files", "damage", "sources", "assets"):
        odd = json.dumps({**header, entry: 1.5}).encode()
        assert f"robot.json: it is truncated or foreign ({entry} is 1.5)" in refusal("robot.json", odd)
    lacking = {name: known for name, known in header["files"].items() if name != "robot-hat.obj"}
    odd = json.dumps({**header, "files": lacking}).encode()
    assert "it does not list 'robot-hat.obj'" in refusal("robot.json", odd)
    folder = tmp_path / "copy"
    (folder / "robot.json").unlink()
    (folder / "robot.json").mkdir()
    with pytest.raises(CheckpointError, match="cannot be read"):
        RobotCopy.read(folder)
    assert RobotCopy.read(tmp_path / "nothing") is None


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("robot.xml", 'file="robot-hat.obj"', 'file="/etc/hostname"'),
        ("robot.xml", "<worldbody>", '<include file="../other.xml"/><worldbody>'),
        ("robot.xml", "<compiler", '<compiler meshdir="/etc"'),
        ("robot.toml", 'mjcf = "robot.xml"', 'mjcf = "../robot.xml"'),
        ("robot.toml", 'name = "tripod"', ""),
        ("robot.xml", "<worldbody>", '<include file="robot-hat.obj"/><worldbody>'),
        (
            "robot.xml",
            "<worldbody>",
            '<default class="<!--"/><include file="/etc/hosts"/><default class="-->"/><worldbody>',
        ),
        (
            "robot.xml",
            "<worldbody>",
            "<![CDATA[<!--]]><include file='/etc/hosts'/><![CDATA[-->]]><worldbody>",
        ),
    ],
)
def test_an_untrusted_copy_reads_only_its_own_files(name: str, old: str, new: str, tmp_path: Path) -> None:
    copy = RobotCopy.of(write_mesh_robot(tmp_path / "robot"), {})
    content = copy.files[name].decode()
    assert old in content
    foreign = dataclasses.replace(copy, files={**copy.files, name: content.replace(old, new, 1).encode()})
    (tmp_path / "copy").mkdir()
    for written, bytes_of in foreign.to_write().items():
        (tmp_path / "copy" / written).write_bytes(bytes_of)
    with pytest.raises(CheckpointError, match=r"which is not a file of the copy|it is broken or foreign"):
        RobotCopy.read(tmp_path / "copy")


def test_an_mjcf_that_only_mujoco_can_complete_is_not_copied_by_halves(tmp_path: Path) -> None:
    copy = RobotCopy.of(write_mesh_robot(tmp_path), {})
    lighter = copy.files["robot.xml"].replace(b'mass="0.05"', b'mass="0.04"')
    broken = dataclasses.replace(copy, files={**copy.files, "robot.xml": lighter})
    copy.check()
    with pytest.raises(ConfigError, match=r"cannot be copied: .* of the copy differs"):
        broken.check()
