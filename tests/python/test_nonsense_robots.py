"""Robots that make no sense are refused before anything is simulated, with every reason at once."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import dappo_batch
from dappo_batch import ConfigError
from dappo_batch._core import run_cli

ROBOTS = Path(__file__).parent / "robots"
Edits = tuple[tuple[str, str], ...]

OPTION = '<option timestep="0.005" integrator="implicitfast"/>'
PLATE = '<body name="plate" pos="0 0 0.17">'
FREE = "<freejoint/>"
END = "</mujoco>"
KNEE = '<joint name="north_knee" axis="0 1 0"/>'


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Work in an empty folder, to which MuJoCo would write MUJOCO_LOG.TXT."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def toy(folder: Path, mjcf: Edits = (), toml: Edits = ()) -> Path:
    """Write the toy robot with some edits, each found exactly once, and return the path of its TOML."""
    for name, changes in (("tripod.xml", mjcf), ("tripod.toml", toml)):
        text = (ROBOTS / name).read_text()
        for old, new in changes:
            assert text.count(old) == 1, old
            text = text.replace(old, new)
        (folder / name).write_text(text)
    return folder / "tripod.toml"


def refusal(path: Path) -> str:
    with pytest.raises(ConfigError) as caught:
        dappo_batch.compile_class_table(path, max_damaged_limbs=0)
    assert not Path("MUJOCO_LOG.TXT").exists()
    return str(caught.value)


def before_the_end(text: str) -> tuple[str, str]:
    return END, text + END


def option(text: str) -> tuple[str, str]:
    return OPTION, OPTION.replace('timestep="0.005"', text)


# What is changed in the TOML, and what the refusal must say. The tests in Rust have one case for each entry.
NONSENSE: dict[str, tuple[str, str, str]] = {
    "endless noise": (
        "qpos_noise = 0.01",
        "qpos_noise = inf",
        "`qpos_noise` is inf, expected a number from 0 to 10",
    ),
    "wild noise": ("qvel_noise = 0.01", "qvel_noise = 4e9", "`qvel_noise` is 4000000000.0"),
    "a weight beyond single precision": ("weight = -0.01", "weight = 1e308", "`weight` is 1"),
    "a scale beyond single precision": ("action_scale = 0.5", "action_scale = 1e308", "`action_scale` is 1"),
    "a step that never ends": ("frame_skip = 4", "frame_skip = 4999", "a whole number from 1 to 1000"),
    "no time limit": ("max_episode_steps = 200", "", "`max_episode_steps` is missing"),
    "damage to less than no limb": (
        "max_damaged_limbs = 3",
        "max_damaged_limbs = -1",
        "a whole number from 0 to 3",
    ),
    "damage to more limbs than there are": ("max_damaged_limbs = 3", "max_damaged_limbs = 4", "from 0 to 3"),
    "a name that leads elsewhere": ('name = "tripod"', 'name = "../tripod"', "expected letters, digits"),
    "a number for a table": ("[reset]\nqpos_noise = 0.01\nqvel_noise = 0.01", "", "`reset` is missing"),
    "more skipped than there is": ("skip = 2", "skip = 99", "qpos skips 99 of 13 positions"),
    "nothing left to observe": ("skip = 2", "skip = 13", "qpos skips 13 of 13 positions"),
}


@pytest.mark.parametrize("name", NONSENSE)
def test_a_toml_that_makes_no_sense_is_rejected_with_the_entry(name: str, folder: Path) -> None:
    old, new, reason = NONSENSE[name]
    assert reason in refusal(toy(folder, toml=((old, new),)))


def test_all_faults_of_a_toml_come_at_once_under_the_name_of_the_file(folder: Path) -> None:
    path = toy(
        folder,
        toml=(
            ("frame_skip = 4", "frame_skip = 0"),
            ('main_body = "plate"\n', ""),
            ("qpos_noise = 0.01", 'qpos_noise = "much"'),
            ('term = "qvel"', 'term = "smell"'),
        ),
    )
    message = refusal(path)
    assert f"the robot TOML {path} has 4 faults" in message
    for part in (
        "`frame_skip` is 0",
        "`main_body` is missing",
        '`qpos_noise` is "much"',
        '`term` is "smell"',
    ):
        assert part in message
    assert "\n  - " in message


@pytest.mark.parametrize("text", ["[" * 100_000, "a." * 100_000 + "a = 1", "a = " + "{a = " * 100_000])
def test_a_toml_nested_100000_deep_is_rejected(folder: Path, text: str) -> None:
    path = folder / "deep.toml"
    path.write_text(text)
    assert "nested more than 32 deep" in refusal(path)


def test_a_toml_that_is_no_file_or_no_text_is_rejected(folder: Path) -> None:
    os.mkfifo(folder / "pipe.toml")
    assert "not a regular file" in refusal(folder / "pipe.toml")
    (folder / "binary.toml").write_bytes(b"\xff\xfe\x00")
    assert "utf-8" in refusal(folder / "binary.toml")
    (folder / "large.toml").write_bytes(b"#" * (2 << 20))
    assert "a robot file at most" in refusal(folder / "large.toml")
    assert "binary.toml" in refusal(folder / "binary.toml")


# What is changed in the MJCF, and what the refusal must say.
ABSURD: dict[str, tuple[Edits, str]] = {
    "a timestep that is no number": ((option('timestep="nan"'),), "opt.timestep is nan"),
    "no time at all": ((option('timestep="0"'),), "the timestep, 0.0 s, must last more than 0"),
    "time that runs backwards": ((option('timestep="-1"'),), "the timestep, -1.0 s, must last more than 0"),
    "time that never passes": ((option('timestep="inf"'),), "opt.timestep is inf"),
    "a step of minutes": ((option('timestep="100"'),), "and at most 10.0 s"),
    "gravity that tears everything apart": (
        (option('timestep="0.5" gravity="0 0 -9e9"'),),
        "diverges in the first env step",
    ),
    "an absurd margin": ((('name="north_toe"', 'name="north_toe" margin="-1e308"'),), "geom_margin"),
    "a huge height field": (
        (before_the_end('<asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset>'),),
        "<hfield>: nrow times ncol is 100000 x 100000",
    ),
    "a huge texture": (
        (before_the_end('<asset><texture name="t" builtin="flat" width="99999" height="99999"/></asset>'),),
        "<texture>: width times height",
    ),
    "a hundred million copies": (
        ((PLATE, f'<replicate count="100000000" offset="1 0 0"><geom size="0.1"/></replicate>{PLATE}'),),
        "it has 2e+08 elements with all copies",
    ),
    "copies of copies": (
        (
            (
                PLATE,
                '<replicate count="1000"><replicate count="1000"><geom'
                f' size="0.1"/></replicate></replicate>{PLATE}',
            ),
        ),
        "it has 2e+06 elements with all copies",
    ),
    "memory beyond all machines": ((before_the_end('<size memory="900G"/>'),), "<size>: memory is 900G"),
    "no memory": ((before_the_end('<size memory="1"/>'),), "out of memory"),
    "a billion numbers a body": ((before_the_end('<size nuser_body="1000000000"/>'),), "<size>: nuser_body"),
    "a delay of a million steps": (
        (('<position name="north_lift"', '<position name="north_lift" delay="1" nsample="1000000"'),),
        "nsample is 1000000",
    ),
    "nested bodies without end": ((before_the_end("<a>" * 300 + "</a>" * 300),), "nested more than 200 deep"),
    "text that is no XML": ((before_the_end("<asset"),), "not well-formed XML"),
    "an unknown element": ((before_the_end("<wheels/>"),), "MuJoCo cannot read"),
}


@pytest.mark.parametrize("name", ABSURD)
def test_an_mjcf_that_makes_no_sense_is_rejected_in_bounded_time_and_memory(name: str, folder: Path) -> None:
    edits, reason = ABSURD[name]
    assert reason in refusal(toy(folder, edits))


@pytest.mark.parametrize(
    "mjcf",
    [
        '<include file="pipe"/>',
        '<asset><model name="other" file="pipe"/></asset>',
        '<asset><mesh name="mesh" file="pipe"/></asset>',
        '<compiler meshdir="sub"/><asset><mesh name="mesh" file="../pipe"/></asset>',
        '<asset><hfield name="h" file="pipe" size="1 1 1 1"/></asset>',
    ],
)
def test_an_mjcf_does_not_wait_for_a_pipe(mjcf: str, folder: Path) -> None:
    os.mkfifo(folder / "pipe")
    (folder / "sub").mkdir()
    assert "is not a regular file" in refusal(toy(folder, (before_the_end(mjcf),)))


def test_an_included_file_is_looked_through_as_well(folder: Path) -> None:
    (folder / "sub").mkdir()
    (folder / "sub" / "part.xml").write_text('<mujoco><include file="sub/terrain.xml"/></mujoco>')
    (folder / "sub" / "terrain.xml").write_text(
        '<mujoco><asset><hfield name="h" nrow="100000" ncol="100000" size="1 1 1 1"/></asset></mujoco>'
    )
    assert "terrain.xml: <hfield>" in refusal(
        toy(folder, (before_the_end('<include file="sub/part.xml"/>'),))
    )


def test_hyphens_in_a_comment_are_no_fault(folder: Path) -> None:
    path = toy(folder, (before_the_end('<!-- -- <replicate count="100000000"> --- -->'),))
    assert len(dappo_batch.compile_class_table(path, max_damaged_limbs=0).models) == 1


SECOND = '<body name="ball" pos="2 0 1"><freejoint/><geom name="ball" type="sphere" size="0.1"/></body>'
SLIDES = """<joint name="x" type="slide" axis="1 0 0" limited="false"/>
  <joint name="z" type="slide" axis="0 0 1" limited="false"/>"""

# What is changed in MJCF and TOML, and what of the guide's list is then missing.
UNFIT: dict[str, tuple[Edits, Edits, str]] = {
    "a base that stands still": (((FREE, ""),), (), "its first joint must be a free joint"),
    "a root in a plane": (((FREE, SLIDES),), (), "the first joint is x (slide)"),
    "a ball before the robot": (
        ((PLATE, SECOND + PLATE),),
        (),
        "main_body plate is not the body of the first free joint, ball",
    ),
    "a limb of the world": (
        ((PLATE, f'<body name="post"><geom name="post" size="0.01 0.01"/></body>{PLATE}'),),
        (('body = "north"', 'body = "post"'), ('["north_lift", "north_knee"]', '["north_lift"]')),
        "body post does not hang on the free body plate",
    ),
    "the robot as its own limb": (
        (),
        (('body = "north"', 'body = "plate"'),),
        "does not hang on the free body",
    ),
    "limbs that share a body": (
        (),
        (('body = "west"', 'body = "north_lower"'),),
        "belongs to limb north already",
    ),
    "joints from the toe to the torso": (
        (),
        (('["north_lift", "north_knee"]', '["north_knee", "north_lift"]'),),
        "joints go from the torso outwards, but north_lift does not hang on north_knee",
    ),
    "the touch sensor of another limb": (
        (('<touch name="north_touch" site="north_site"/>', '<touch name="north_touch" site="west_site"/>'),),
        (),
        "the site of sensor north_touch lies on no body of the limb",
    ),
    "a fall before the first step": (
        (),
        (("[0.05, 0.6]", "[0.3, 0.6]"),),
        "episodes begin at a height of 0.17 m",
    ),
    "a fall by the noise": (
        (),
        (("qpos_noise = 0.01", "qpos_noise = 0.2"),),
        "plus or minus the qpos_noise of 0.2",
    ),
}


def with_pictures(folder: Path, entry: str, mjcf: Edits = ()) -> Path:
    """Write the toy robot with an entry in [pictures]."""
    return toy(folder, mjcf, (("[termination]", f"[pictures]\n{entry}\n\n[termination]"),))


@pytest.mark.parametrize(
    ("cameras", "reason"),
    [
        ("", "the MJCF has no camera 'side'; it has none with a name"),
        ('<camera pos="0 -2 1"/>', "the MJCF has no camera 'side'; it has none with a name"),
        ('<camera name="front"/><camera/><camera name="top"/>', "expected one of 'front', 'top'"),
    ],
)
def test_a_camera_that_the_mjcf_lacks_is_rejected_with_the_existing_ones(
    cameras: str, reason: str, folder: Path
) -> None:
    mjcf = ((PLATE, f"{cameras}{PLATE}"),)
    path = with_pictures(folder, 'camera = "side"', mjcf)
    message = refusal(path)
    assert "[pictures] camera: " in message
    assert reason in message
    with pytest.raises(ConfigError, match="no camera 'side'"):
        dappo_batch.check_robot(path)


def test_the_camera_of_the_mjcf_and_no_camera_are_accepted(folder: Path) -> None:
    mjcf = ((PLATE, f'<camera name="side"/>{PLATE}'),)
    for entry in ('camera = "side"', ""):
        path = with_pictures(folder, entry, mjcf)
        assert len(dappo_batch.compile_class_table(path, max_damaged_limbs=0).models) == 1


def test_entries_of_pictures_that_nothing_reads_are_rejected(folder: Path) -> None:
    assert "[pictures]: unknown entries kamera" in refusal(with_pictures(folder, 'kamera = "side"'))
    assert "[pictures]: `camera` is 5, expected a text" in refusal(with_pictures(folder, "camera = 5"))


@pytest.mark.parametrize("name", UNFIT)
def test_a_robot_without_what_the_guide_requires_is_rejected(name: str, folder: Path) -> None:
    mjcf, toml, reason = UNFIT[name]
    assert reason in refusal(toy(folder, mjcf, toml))


def test_a_robot_that_nothing_moves_is_rejected(folder: Path) -> None:
    text = (ROBOTS / "tripod.xml").read_text()
    actuators = text[text.index("<actuator>") : text.index("</actuator>")]
    assert "it has no actuators" in refusal(toy(folder, ((actuators, "<actuator>"),)))


def test_everything_that_a_robot_lacks_comes_at_once(folder: Path) -> None:
    mjcf = ((FREE, ""), ('name="north_toe"', 'name="toe"'), ('name="west_knee" axis', 'name="knee" axis'))
    path = toy(folder, (*mjcf, ('<position name="west_knee" joint="west_knee"/>', "")))
    message = refusal(path)
    for part in ("no geom 'north_toe'", "no joint 'west_knee'", "must be a free joint"):
        assert part in message
    assert "\n  - " in message


@pytest.mark.parametrize("backend", ["auto", "lanes", "mujoco"])
def test_no_backend_takes_an_unfit_robot(backend: str, folder: Path) -> None:
    path = toy(folder, ((PLATE, SECOND + PLATE),))
    with pytest.raises(ConfigError, match="main_body plate is not the body of the first free joint"):
        dappo_batch.make_vec(path, 1, backend=backend)  # type: ignore[arg-type]


def test_a_ball_after_the_robot_is_accepted(folder: Path) -> None:
    path = toy(folder, (("  </worldbody>", f"{SECOND}</worldbody>"),))
    envs = dappo_batch.make_vec(path, 1, max_damaged_limbs=0)
    assert envs.backend == "mujoco"
    envs.reset()
    assert not envs.step(envs.action_space.sample())[2].any()


def test_a_limb_needs_no_toe_geom_where_its_lowest_segment_is_one_capsule(folder: Path) -> None:
    whole = dappo_batch.compile_class_table(toy(folder))
    path = toy(folder, toml=(('toe_geom = "north_toe"\n', ""),))
    assert dappo_batch.load_robot(path).limbs[0].toe_geom is None
    table = dappo_batch.compile_class_table(path)
    damaged = table.space.parse("missing_toe@0")
    assert table.models[damaged].body_mass.sum() < 0.99 * table.models[0].body_mass.sum()
    np.testing.assert_allclose(table.models[damaged].body_mass, whole.models[damaged].body_mass, rtol=1e-3)


def test_limbs_that_cannot_break_are_all_in_one_error(folder: Path) -> None:
    path = toy(folder, toml=(("joint = 1", "joint = 7"),))
    with pytest.raises(ConfigError) as caught:
        dappo_batch.compile_class_table(path)
    assert [f"limb {name} has 2 joints" in str(caught.value) for name in ("north", "west", "east")] == [
        True
    ] * 3


def test_classes_of_a_robot_that_does_not_exist_are_not_listed(
    folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = toy(folder, toml=(('body = "north"', 'body = "south"'),))
    assert run_cli(["classes", "--robot", str(path)]) == 1
    printed = capfd.readouterr()
    assert "the MJCF has no body 'south'" in printed.err
    assert "missing_toe" not in printed.out


@pytest.mark.parametrize("backend", ["lanes", "mujoco"])
def test_a_training_of_an_unfit_robot_leaves_no_run_folder(
    backend: str, folder: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    path = toy(folder, ((PLATE, SECOND + PLATE),))
    arguments = ["train", "--robot", str(path), "--run", str(folder / "run"), "--backend", backend]
    assert run_cli([*arguments, "--steps", "64", "--envs", "2", "--threads", "1"]) == 1
    assert "main_body plate is not the body of the first free joint" in capfd.readouterr().err
    assert not (folder / "run").exists()
