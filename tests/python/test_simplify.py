"""[simplify] and [[override]] give the robot of an MJCF that is edited by hand, to all its users."""

from __future__ import annotations

import shutil
from pathlib import Path

import mujoco
import numpy as np
import pytest

import dappo_batch
from dappo_batch import ClassTable, ConfigError
from dappo_batch.report.units import step_seconds

from .command_line import TINY
from .command_line import dappo_batch as run

ROBOTS = Path(__file__).parent / "robots"
Edits = tuple[tuple[str, str], ...]

OPTION = '<option timestep="0.005" integrator="implicitfast"/>'
GEOMS = '<geom type="capsule" conaffinity="0" friction="0.8 0.01 0.001" density="400"/>'
FLOOR = '<geom type="plane" size="10 10 1" conaffinity="1"'
KNEE = '<joint name="north_knee" axis="0 1 0"/>'
SERVO = '<position name="north_knee" joint="north_knee"/>'
TOE = '<geom name="north_toe"'
PLATE = '<geom type="cylinder" size="0.12 0.02" mass="1"/>'
FREE = "<freejoint/>"
TOUCHES_ITSELF: Edits = ((GEOMS, GEOMS.replace(' conaffinity="0"', "")),)


def write(folder: Path, mjcf: Edits = (), tables: str = "") -> Path:
    """Write the toy robot after edits of its MJCF, each found once, and with more tables in its TOML."""
    folder.mkdir(exist_ok=True)
    text = (ROBOTS / "tripod.xml").read_text()
    for old, new in mjcf:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    (folder / "tripod.xml").write_text(text)
    path = folder / "tripod.toml"
    path.write_text(f"{(ROBOTS / path.name).read_text()}\n{tables}\n")
    return path


def compiled(path: Path) -> ClassTable:
    return dappo_batch.compile_class_table(path, max_damaged_limbs=1)


def different(one: mujoco.MjModel, other: mujoco.MjModel) -> list[str]:
    """Return the arrays and options that differ."""
    names = [name for name in dir(one) if isinstance(getattr(one, name), np.ndarray) and "path" not in name]
    found = [name for name in names if not np.array_equal(getattr(one, name), getattr(other, name))]
    options = [name for name in dir(one.opt) if not name.startswith("_")]
    return found + [
        name for name in options if not np.array_equal(getattr(one.opt, name), getattr(other.opt, name))
    ]


# Tables of the TOML, the MJCF that they are applied to, and the edits of it that do the same by hand.
EQUAL: dict[str, tuple[str, Edits, Edits]] = {
    "no self-collision": ("[simplify]\nself_collision = false", TOUCHES_ITSELF, ()),
    "self-collision that there is not": ("[simplify]\nself_collision = false", (), ()),
    "geoms on the floor": (
        '[simplify]\nfloor_contacts = ["north_toe", "west_toe", "east_toe"]',
        TOUCHES_ITSELF,
        (
            (GEOMS, GEOMS.replace("capsule", 'capsule" contype="0')),
            *((f'name="{limb}_toe"', f'name="{limb}_toe" contype="1"') for limb in ("north", "west", "east")),
        ),
    ),
    "bodies on the floor": (
        '[simplify]\nfloor_contacts = ["plate", "west_lower", "north_toe"]',
        TOUCHES_ITSELF,
        (
            (GEOMS, GEOMS.replace("capsule", 'capsule" contype="0')),
            (PLATE, PLATE.replace("mass", 'contype="1" mass')),
            *((f'name="{limb}_toe"', f'name="{limb}_toe" contype="1"') for limb in ("north", "west")),
        ),
    ),
    "options": (
        '[simplify]\ncone = "elliptic"\ntimestep = 0.004\nintegrator = "euler"\nimpratio = 2',
        (),
        ((OPTION, '<option timestep="0.004" integrator="Euler" cone="elliptic" impratio="2"/>'),),
    ),
    "another integrator": (
        '[simplify]\nintegrator = "rk4"\ncone = "pyramidal"',
        ((OPTION, OPTION.replace("/>", ' cone="elliptic"/>')),),
        ((OPTION, OPTION.replace("implicitfast", "RK4")),),
    ),
    "condim": (
        "[simplify]\ncondim = 1",
        ((FLOOR, f'{FLOOR} condim="4"'),),
        ((FLOOR, f'{FLOOR} condim="1"'), (GEOMS, GEOMS.replace("capsule", 'capsule" condim="1'))),
    ),
    "a joint": (
        '[[override]]\njoints = "north_knee"\narmature = 0.02\ndamping = 0.7\nfrictionloss = 0.1\n'
        "stiffness = 3\nrange = [-0.5, 0.4]",
        ((KNEE, KNEE.replace("/>", ' limited="false"/>')),),
        (
            (
                KNEE,
                KNEE.replace(
                    "/>", ' armature="0.02" damping="0.7" frictionloss="0.1" stiffness="3" range="-0.5 0.4"/>'
                ),
            ),
        ),
    ),
    "all joints but the free one": (
        '[[override]]\njoints = ".*"\ndamping = 0.25',
        (),
        (('damping="0.5"', 'damping="0.25"'),),
    ),
    "the free joint": (
        '[[override]]\njoints = "plate"\ndamping = 0\narmature = 0',
        ((FREE, '<joint type="free"/>'),),
        ((FREE, '<joint type="free" damping="0" armature="0"/>'),),
    ),
    "later tables over earlier ones": (
        '[[override]]\njoints = ".*_knee"\ndamping = 0.1\n[[override]]\njoints = ".*"\ndamping = 0.25',
        (),
        (('damping="0.5"', 'damping="0.25"'),),
    ),
    "a servo": (
        '[[override]]\nactuators = "north_knee"\nkp = 20\nkd = 0.5\nforce_range = [-2, 3]\n'
        "ctrl_range = [-0.4, 0.3]\ngear = 1.5",
        (),
        (
            (
                SERVO,
                SERVO.replace("/>", ' kp="20" kv="0.5" forcerange="-2 3" ctrlrange="-0.4 0.3" gear="1.5"/>'),
            ),
        ),
    ),
    "one gain of a servo": (
        '[[override]]\nactuators = "north_knee"\nkp = 20',
        ((SERVO, SERVO.replace("/>", ' kv="0.3"/>')),),
        ((SERVO, SERVO.replace("/>", ' kp="20" kv="0.3"/>')),),
    ),
    "a ratio of damping": (
        '[[override]]\nactuators = "north_knee"\nkp = 20',
        ((SERVO, SERVO.replace("/>", ' dampratio="1"/>')),),
        ((SERVO, SERVO.replace("/>", ' kp="20" dampratio="1"/>')),),
    ),
    "a motor for a servo": (
        '[[override]]\nactuators = "north_knee"\ncontrol = "torque"\nctrl_range = [-9, 9]',
        (),
        ((SERVO, '<motor name="north_knee" joint="north_knee" ctrlrange="-9 9"/>'),),
    ),
    "a servo for a motor": (
        '[[override]]\nactuators = "north_knee"\ncontrol = "position"\nkp = 8\nkd = 0.2\n'
        "ctrl_range = [-0.3, 0.3]",
        ((SERVO, '<motor name="north_knee" joint="north_knee" ctrlrange="-9 9" forcerange="-2 2"/>'),),
        (
            (
                SERVO,
                '<position name="north_knee" joint="north_knee" kp="8" kv="0.2" ctrlrange="-0.3 0.3"'
                ' forcerange="-2 2"/>',
            ),
        ),
    ),
    "a servo without its filter": (
        '[[override]]\nactuators = "north_knee"\ncontrol = "position"',
        ((SERVO, SERVO.replace("/>", ' timeconst="0.1" kv="0.3"/>')),),
        ((SERVO, SERVO.replace("/>", ' kv="0.3"/>')),),
    ),
    "a motor for a muscle": (
        '[[override]]\nactuators = "north_knee"\ncontrol = "torque"\nctrl_range = [-1, 1]',
        ((SERVO, '<muscle name="north_knee" joint="north_knee" ctrlrange="0 1" lengthrange="0.1 1"/>'),),
        ((SERVO, '<motor name="north_knee" joint="north_knee" ctrlrange="-1 1" lengthrange="0.1 1"/>'),),
    ),
    "an actuator without a name": (
        '[[override]]\nactuators = "north_.*ee"\nkp = 20',
        ((SERVO, SERVO.replace('name="north_knee" ', "")),),
        ((SERVO, SERVO.replace('name="north_knee" ', 'kp="20" ')),),
    ),
    "a geom": (
        '[[override]]\ngeoms = "north_toe"\nfriction = [0.5, 0.02]\ncondim = 4\nsolref = [0.03, 0.9]\n'
        "solimp = [0.8, 0.9, 0.002]\nmargin = 0.001",
        (),
        (
            (
                TOE,
                f'{TOE} friction="0.5 0.02 0.001" condim="4" solref="0.03 0.9" solimp="0.8 0.9 0.002 0.5 2"'
                ' margin="0.001"',
            ),
        ),
    ),
    "geoms without a name": (
        '[[override]]\ngeoms = "plate"\nfriction = 0.5',
        (),
        ((PLATE, PLATE.replace("mass", 'friction="0.5 0.01 0.001" mass')),),
    ),
}


@pytest.mark.parametrize("name", EQUAL)
def test_the_models_are_those_of_an_mjcf_that_is_edited_by_hand(name: str, tmp_path: Path) -> None:
    tables, mjcf, by_hand = EQUAL[name]
    simplified = compiled(write(tmp_path / "a", mjcf, tables))
    expected = compiled(write(tmp_path / "b", by_hand))
    for one, other in zip(simplified.models, expected.models, strict=True):
        assert different(one, other) == []


def test_ranges_are_in_radians_for_an_mjcf_in_degrees(tmp_path: Path) -> None:
    folder = dappo_batch.load_robot("ant").path.parent
    shutil.copy(folder / "ant.xml", tmp_path)
    tables = '[[override]]\njoints = "hip_1"\nrange = [-0.2, 0.3]'
    (tmp_path / "ant.toml").write_text(f"{(folder / 'ant.toml').read_text()}\n{tables}\n")
    table = compiled(tmp_path / "ant.toml")
    assert table.models[0].joint("hip_1").range.tolist() == pytest.approx([-0.2, 0.3], abs=1e-15)
    (edit,) = table.edits
    assert str(edit) == "[[override]] 0 range of hip_1: [-0.523599, 0.523599] → [-0.2, 0.3]"


def test_what_is_changed_is_recorded_with_the_values_before(tmp_path: Path) -> None:
    tables = (
        '[simplify]\nself_collision = false\ntimestep = 0.005\ncone = "elliptic"\n'
        '[[override]]\njoints = ".*_knee"\narmature = 0.02\ndamping = 0.5'
    )
    table = compiled(write(tmp_path, TOUCHES_ITSELF, tables))
    # The timestep and the damping are those of the MJCF.
    assert list(map(str, table.edits)) == [
        "[simplify] cone: pyramidal → elliptic",
        "[simplify] self_collision: true → false",
        "[[override]] 0 armature of north_knee, west_knee, east_knee: 0.01 → 0.02",
    ]
    assert compiled(ROBOTS / "tripod.toml").edits == ()


def test_an_argument_for_the_integrator_takes_precedence(tmp_path: Path) -> None:
    path = write(tmp_path, tables='[simplify]\nintegrator = "rk4"')
    table = dappo_batch.compile_class_table(path, max_damaged_limbs=0, physics="euler")
    assert table.models[0].opt.integrator == mujoco.mjtIntegrator.mjINT_EULER


def allowed(model: mujoco.MjModel) -> np.ndarray:
    """Return which geoms may touch by their masks, [G, G]."""
    types, affinities = model.geom_contype, model.geom_conaffinity
    return (types[:, None] & affinities[None] | types[None] & affinities[:, None]) != 0


@pytest.mark.parametrize("seed", range(20))
def test_only_contacts_within_the_robot_are_removed_whatever_the_masks(seed: int, tmp_path: Path) -> None:
    rng = np.random.default_rng(seed)

    def masks() -> str:
        return f'contype="{rng.integers(0, 16)}" conaffinity="{rng.integers(0, 16)}"'

    things = "".join(
        f'<geom type="box" size="1 1 1" pos="{9 + 3 * index} 0 0" {masks()}/>'
        f'<body pos="{9 + 3 * index} 9 1"><freejoint/><geom type="sphere" size="0.1" {masks()}/></body>'
        for index in range(3)
    )
    text = (ROBOTS / "tripod.xml").read_text()
    for geom in ('<geom size="0.02 0.06"', '_toe" size="0.025 0.08"'):
        for _ in range(3):
            text = text.replace(f"{geom} pos", f"{geom} {masks()} pos", 1)
    text = text.replace(PLATE, PLATE.replace("mass", f"{masks()} mass"))
    text = text.replace("</worldbody>", f"{things}</worldbody>").replace(FLOOR, f"{FLOOR[:-15]} {masks()}")
    path = write(tmp_path, tables="[simplify]\nself_collision = false")
    (tmp_path / "tripod.xml").write_text(text)
    before = mujoco.MjModel.from_xml_string(text)
    after = compiled(path).models[0]
    robot = before.body_rootid[before.geom_bodyid] == before.body("plate").id
    static = before.body_weldid[before.geom_bodyid] == 0
    expected = allowed(before) & ~(robot[:, None] & robot[None]) & ~(static[:, None] & static[None])
    paired = np.zeros_like(expected)
    paired[after.pair_geom1, after.pair_geom2] = paired[after.pair_geom2, after.pair_geom1] = True
    assert np.array_equal((allowed(after) | paired) & ~(static[:, None] & static[None]), expected)


def test_explicit_pairs_within_the_robot_and_of_other_geoms_are_removed(tmp_path: Path) -> None:
    pairs = "".join(
        f'<pair geom1="{one}" geom2="{other}"/>'
        for one, other in (("floor", "north_toe"), ("floor", "west_toe"), ("west_toe", "north_toe"))
    )
    mjcf = (
        (FLOOR, '<geom name="floor" type="plane" size="10 10 1" contype="0"'),
        (GEOMS, GEOMS.replace("capsule", 'capsule" contype="0')),
        ("</mujoco>", f"<contact>{pairs}</contact></mujoco>"),
    )
    for tables, expected in (
        ("[simplify]\nself_collision = false", [("floor", "north_toe"), ("floor", "west_toe")]),
        ('[simplify]\nfloor_contacts = ["west_toe"]', [("floor", "west_toe")]),
    ):
        model = compiled(write(tmp_path, mjcf, tables)).models[0]
        ends = zip(model.pair_geom1, model.pair_geom2, strict=True)
        assert [tuple(model.geom(int(end)).name for end in pair) for pair in ends] == expected


# Tables, and what the refusal must say.
FAULTS: dict[str, tuple[str, str]] = {
    "joint": (
        '[[override]]\njoints = ".*_kneee"\ndamping = 1',
        "[[override]] 0: no joint matches '.*_kneee'; the robot has north_lift, north_knee, west_lift",
    ),
    "part of a name": ('[[override]]\njoints = "knee"\ndamping = 1', "no joint matches 'knee'"),
    "actuator": (
        '[[override]]\nactuators = "motor"\nkp = 1',
        "no actuator matches 'motor'; the robot has north_lift",
    ),
    "geom": (
        '[[override]]\ngeoms = "foot"\ncondim = 1',
        "no geom matches 'foot'; the robot has world, plate, north",
    ),
    "expression": (
        '[[override]]\ngeoms = "(foot"\ncondim = 1',
        "geoms = '(foot' is not a regular expression",
    ),
    "floor contact": (
        '[simplify]\nfloor_contacts = ["nort_toe"]',
        "[simplify] floor_contacts: there is no geom or body 'nort_toe'; did you mean north_toe",
    ),
    "unlike any": (
        '[simplify]\nfloor_contacts = ["FR"]',
        "there is no geom or body 'FR'; the robot has plate, north, north_toe",
    ),
    "the world": (
        '[simplify]\nfloor_contacts = ["world"]',
        "body 'world' has no geom that can touch anything",
    ),
    "a spring of the free joint": (
        '[[override]]\njoints = "plate"\nstiffness = 1',
        "joint plate is free, so it has no stiffness",
    ),
    "range in another unit": (
        '[[override]]\nactuators = "north_knee"\ncontrol = "torque"',
        "the control of actuator north_knee becomes a torque, which its range ([-0.5, 0.5]) was not made for;"
        " add ctrl_range",
    ),
}


@pytest.mark.parametrize("name", FAULTS)
def test_an_entry_that_cannot_be_applied_is_refused_with_what_the_robot_has(
    name: str, tmp_path: Path
) -> None:
    tables, fault = FAULTS[name]
    path = write(tmp_path, tables=tables)
    with pytest.raises(ConfigError) as caught:
        compiled(path)
    assert str(caught.value).startswith("robot tripod: ")
    assert fault in str(caught.value)


def test_gains_of_a_motor_and_missing_ones_are_refused(tmp_path: Path) -> None:
    motor = ((SERVO, '<motor name="north_knee" joint="north_knee"/>'),)
    for entries, fault in (
        ("kp = 3", 'actuator north_knee has no position control, so no kp; add control = "position"'),
        ('control = "position"\nkd = 3', 'control = "position" of actuator north_knee needs a kp'),
    ):
        path = write(tmp_path, motor, f'[[override]]\nactuators = "north_knee"\n{entries}')
        with pytest.raises(ConfigError, match=fault):
            compiled(path)


def test_geoms_that_touch_nothing_have_no_friction(tmp_path: Path) -> None:
    mjcf = ((TOE, f'{TOE} contype="0"'),)
    for tables, fault in (
        ('[[override]]\ngeoms = "north_toe"\nfriction = 1', "north_toe) can touch anything"),
        (
            '[simplify]\nfloor_contacts = ["north_toe"]',
            "geom 'north_toe' is not part of the robot, or can touch",
        ),
    ):
        with pytest.raises(ConfigError) as caught:
            compiled(write(tmp_path, mjcf, tables))
        assert fault in str(caught.value).replace("no geom that matches 'north_toe' (", "")


def test_all_faults_come_at_once(tmp_path: Path) -> None:
    tables = (
        '[simplify]\nfloor_contacts = ["a", "b"]\n[[override]]\njoints = "c"\ndamping = 1\n'
        '[[override]]\ngeoms = "d"\nmargin = 1'
    )
    with pytest.raises(ConfigError, match="has 4 faults"):
        compiled(write(tmp_path, tables=tables))


def test_a_run_keeps_the_simplified_robot_and_a_change_of_it_is_an_error(tmp_path: Path) -> None:
    tables = (
        '[simplify]\nfloor_contacts = ["north_toe", "west_lower", "east_toe"]\ntimestep = 0.004\n'
        '[[override]]\njoints = ".*_knee"\ndamping = 0.7'
    )
    path = write(tmp_path / "robot", TOUCHES_ITSELF, tables)
    folder = tmp_path / "run"
    run("train", "--robot", path, *TINY, "--steps", "64", "--run", folder)
    expected = compiled(path)
    kept = compiled(folder / "robot" / "robot.toml")
    assert kept.edits == expected.edits != ()
    for one, other in zip(kept.models, expected.models, strict=True):
        assert different(one, other) == []
    assert step_seconds(dappo_batch.load_run(folder)) == pytest.approx(0.016)

    run("train", "--resume", folder, "--steps", "128")
    run("export", folder, "--out", tmp_path / "export")
    assert dappo_batch.Policy.from_export(tmp_path / "export").obs_dim
    write(tmp_path / "robot", TOUCHES_ITSELF, tables.replace("0.004", "0.003"))
    _, err = run("evaluate", folder, "--episodes", "1", code=1)
    assert "simplify.timestep: 0.004 → 0.003" in err
    shutil.rmtree(tmp_path / "robot")
    run("evaluate", folder, "--episodes", "1", "--threads", "1")
