"""Compiled variants: bodies, severities and jammed joints that differ between episodes."""

from __future__ import annotations

import copy
import importlib.util
import math
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import dappo_batch as db
from dappo_batch import ClassTable, ConfigError
from dappo_batch.damage import JammedJoint

Array = NDArray[np.float64]

BACKENDS = ("lanes", "mujoco")

ROBOT = """
name = "strider"
mjcf = "strider.xml"
main_body = "trunk"
frame_skip = 4
max_episode_steps = 1000
limbs = [
  { name = "left", body = "left_thigh", joints = ["left_hip", "left_knee"], foot = "left_foot" },
  { name = "right", body = "right_thigh", joints = ["right_hip", "right_knee"], foot = "right_foot" },
]
damage.types = ["jammed_joint", "weak_motor"]
damage.max_damaged_limbs = 2
damage.jammed_joint = { joint = 1, range_deg = 0.5, at = "middle" }
actions = { type = "control", scale = 3.0 }
reset = { qpos_noise = 0.05, qvel_noise = 0.3 }
observation.policy.terms = [
  { term = "qpos" }, { term = "qvel" }, { term = "foot_height" }, { term = "events" },
]
rewards.survive.weight = 1.0
terminations.height = [-inf, inf]
"""

EVENTS = """
[events]
variants = 4
friction = { scale = [0.5, 1.5] }
link_length = [{ bodies = ".*_thigh", scale = [0.8, 1.3] }, { bodies = ".*_shank", scale = [0.7, 1.1] }]
mass = [{ bodies = "trunk", scale = [0.8, 1.4] }, { bodies = ".*_thigh", scale = [0.5, 2.0] }]
center_of_mass = { bodies = "trunk", offset = [-0.03, 0.05] }
"""

NAMES = [
    *("link_length .*_thigh", "link_length .*_shank", "mass trunk", "mass .*_thigh"),
    *("center_of_mass trunk x", "center_of_mass trunk y", "center_of_mass trunk z"),
]


def mjcf(
    thigh: float = 1, shank: float = 1, trunk_mass: float = 1, thigh_mass: float = 1, *com: float
) -> str:
    """Return the robot with the numbers of a variant in the places where MuJoCo reads them."""
    offset = np.add(com or (0, 0, 0), (0.01, 0.002, -0.005))
    # The shank is a box of 0.3 kg and 3 x 2 x 18 cm, stretched along its last side. Its largest moment of
    # inertia, the first one in MuJoCo, is that about y.
    mass, sides = 0.3 * shank, np.array([0.03, 0.02, 0.18 * shank])
    box = mass / 12 * ((sides**2).sum() - sides**2)
    limbs = "".join(
        f"""
        <body name="{side}_thigh" pos="0 {y} 0">
          <joint name="{side}_hip" axis="0 1 0" range="-1 1.2"/>
          <geom type="capsule" fromto="0 0 0 0 0 {-0.2 * thigh}" size="0.02" density="{800 * thigh_mass}"
            contype="0" conaffinity="0"/>
          <body name="{side}_shank" pos="0 0 {-0.2 * thigh}">
            <inertial mass="{mass}" pos="0.004 0 {-0.09 * shank}"
              quat="0 1 1 0" diaginertia="{box[1]} {box[0]} {box[2]}"/>
            <joint name="{side}_knee" axis="0 1 0" range="-1.5 -0.2" ref="-0.5"/>
            <geom type="box" pos="0 0 {-0.08 * shank}" size="0.01 0.012 {0.07 * shank}" contype="0"
              conaffinity="0"/>
            <geom name="{side}_foot" type="sphere" pos="0 0 {-0.18 * shank}" size="0.02"/>
          </body>
        </body>"""
        for side, y in (("left", 0.12), ("right", -0.12))
    )
    i = np.array([0.011, 0.021, 0.03, 0.0007, -0.0004, 0.0002]) * trunk_mass
    return f"""
<mujoco>
  <compiler angle="radian"/>
  <option timestep="0.005" integrator="implicitfast"/>
  <default>
    <geom contype="0" conaffinity="1"/>
    <joint armature="0.01" damping="0.1"/>
    <motor ctrlrange="-3 3"/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="9 9 1" contype="1" conaffinity="0"/>
    <body name="trunk" pos="0 0 0.45">
      <freejoint/>
      <inertial mass="{2 * trunk_mass}" pos="{offset[0]} {offset[1]} {offset[2]}"
        fullinertia="{" ".join(map(repr, map(float, i)))}"/>
      <geom type="box" size="0.15 0.1 0.03" contype="0" conaffinity="0"/>
      {limbs}
    </body>
  </worldbody>
  <actuator>
    <motor joint="left_hip"/> <motor joint="left_knee"/>
    <motor joint="right_hip"/> <motor joint="right_knee"/>
  </actuator>
</mujoco>
"""


def robot(folder: Path, events: str = "", text: str | None = None) -> Path:
    """Write the robot, and return the path of its TOML."""
    folder.mkdir(exist_ok=True)
    (folder / "strider.toml").write_text(ROBOT + events)
    (folder / "strider.xml").write_text(mjcf() if text is None else text)
    return folder / "strider.toml"


def arrays(model: mujoco.MjModel) -> dict[str, Array]:
    """Return all arrays of a model."""
    values = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    found = {name: value for name, value in values.items() if isinstance(value, np.ndarray)}
    assert len(found) > 300
    return found | {"gravity": model.opt.gravity, "meaninertia": np.array(model.stat.meaninertia)}


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> ClassTable:
    return db.compile_class_table(robot(tmp_path_factory.mktemp("strider"), EVENTS))


def test_every_model_is_that_of_an_mjcf_with_the_numbers_of_its_variant(
    table: ClassTable, tmp_path: Path
) -> None:
    variants = table.variants
    assert list(variants.names) == NAMES
    assert len(variants.numbers) == 4
    assert len(table.all_models) == 4 * len(table.space.classes)
    assert table.models == table.all_models[: len(table.space.classes)]
    for index, numbers in enumerate(variants.numbers):
        plain = db.compile_class_table(robot(tmp_path / str(index), text=mjcf(*numbers)))
        for item, (of_class, expected) in enumerate(zip(variants.models, plain.models, strict=True)):
            got = arrays(table.all_models[of_class[index]])
            for name, values in arrays(expected).items():
                np.testing.assert_allclose(
                    got[name], values, rtol=1e-11, atol=1e-13, err_msg=f"{name}, class {item}"
                )
    # They differ, so that the comparison means something.
    masses = {float(table.all_models[of_class].body_mass[1]) for of_class in variants.models[0]}
    assert len(masses) == 4


def test_numbers_lie_in_their_ranges_one_in_each_part(table: ClassTable) -> None:
    numbers = np.array(table.variants.numbers)
    ranges = ((0.8, 1.3), (0.7, 1.1), (0.8, 1.4), (0.5, 2.0), *[(-0.03, 0.05)] * 3)
    for column, (low, high) in zip(numbers.T, ranges, strict=True):
        parts = np.floor((column - low) / (high - low) * 4)
        np.testing.assert_array_equal(np.sort(parts), np.arange(4))


def test_a_copy_of_the_robot_has_the_same_variants(table: ClassTable, tmp_path: Path) -> None:
    again = db.compile_class_table(robot(tmp_path / "copy", EVENTS))
    assert again.variants == table.variants


def model_of(table: ClassTable, events: dict[str, float], damage_class: int) -> mujoco.MjModel:
    """Return a copy of the model of an env, by what its infos say of it."""
    variant = table.variants.numbers.index(tuple(events[name] for name in table.variants.names))
    model = copy.copy(table.all_models[table.variants.models[damage_class][variant]])
    model.geom_friction *= events["friction"]
    model.pair_friction *= events["friction"]
    return model


@pytest.mark.parametrize("backend", BACKENDS)
def test_envs_move_as_the_models_of_their_variants_before_and_after_the_onset(
    table: ClassTable, backend: str
) -> None:
    count, onset = 16, 8
    env = db.make_vec(table, count, backend=backend, precision="f64", seed=2, onset=onset, threads=2)
    classes = np.arange(count) % len(table.space.classes)
    _, infos = env.reset(options={"damage_class": classes})
    assert len({tuple(row[9:]) for row in infos["events"]}) == 4
    drawn = [dict(zip(env.event_names, row, strict=True)) for row in infos["events"].tolist()]
    models = [
        [model_of(table, events, item) for item in (0, of_env)]
        for events, of_env in zip(drawn, classes.tolist(), strict=True)
    ]
    data = [mujoco.MjData(pair[0]) for pair in models]
    for world, pair, qpos, qvel in zip(data, models, *env.get_state(), strict=True):
        world.qpos[:], world.qvel[:] = qpos, qvel
        mujoco.mj_forward(pair[0], world)
    rng = np.random.default_rng(4)
    for step in range(20):
        actions = rng.uniform(-1, 1, (count, 4)).astype(np.float32)
        obs, _, _, _, infos = env.step(actions)
        for index, (world, pair) in enumerate(zip(data, models, strict=True)):
            world.ctrl[:] = 3.0 * actions[index].astype(np.float64)
            mujoco.mj_step(pair[step >= onset], world, nstep=4)
            state = np.concatenate([values[index] for values in env.get_state()])
            expected = np.concatenate([world.qpos, world.qvel])
            np.testing.assert_allclose(state, expected, rtol=1e-10, atol=1e-10, err_msg=f"{index}, {step}")
            feet = [table.models[0].geom(f"{side}_foot").id for side in ("left", "right")]
            mujoco.mj_kinematics(pair[0], world)
            np.testing.assert_allclose(obs[index, 21:23], world.geom_xpos[feet, 2], rtol=1e-5, atol=1e-6)
    env.close()


def test_the_backends_agree_and_observations_show_what_infos_hold(table: ClassTable) -> None:
    envs = [
        db.make_vec(table, 32, backend=name, precision="f64", seed=7, onset=(0, 12), max_episode_steps=20)
        for name in BACKENDS
    ]
    rng = np.random.default_rng(0)
    resets = [env.reset() for env in envs]
    np.testing.assert_array_equal(resets[0][1]["events"], resets[1][1]["events"])
    width = resets[0][1]["events"].shape[1]
    assert envs[0].event_names[9:] == NAMES
    seen = set()
    for _ in range(45):
        action = rng.uniform(-1, 1, (32, 4)).astype(np.float32)
        (obs, _, _, _, infos), other = (env.step(action) for env in envs)
        for one, two in zip(*(env.get_state() for env in envs), strict=True):
            np.testing.assert_allclose(one, two, rtol=1e-10, atol=1e-10)
        np.testing.assert_array_equal(infos["events"], other[4]["events"])
        np.testing.assert_array_equal(obs[:, 23 : 23 + width], infos["events"].astype(np.float32))
        seen |= {tuple(row) for row in infos["events"][:, 9:]}
    assert seen == set(table.variants.numbers)
    for env in envs:
        env.close()


def test_severities_are_drawn_from_compiled_levels(tmp_path: Path) -> None:
    path = robot(tmp_path)
    table = db.compile_class_table(path, severity=(0.25, 1.0), severity_levels=4)
    classes = len(table.space.classes)
    assert table.variants.names == ("severity",)
    assert len(table.all_models) == 4 * (classes - 1) + 1
    for level, severity in enumerate((0.25, 0.5, 0.75, 1.0)):
        assert table.variants.numbers[level] == pytest.approx((severity,))
        plain = db.compile_class_table(path, severity=severity)
        for of_class, expected in zip(table.variants.models, plain.models, strict=True):
            got = arrays(table.all_models[of_class[level]])
            for name, values in arrays(expected).items():
                np.testing.assert_array_equal(got[name], values, err_msg=name)
    env = db.make_vec(path, 64, severity=(0.25, 1.0), seed=1, max_episode_steps=3, autoreset="same_step")
    _, infos = env.reset()
    assert env.event_names == ["severity"]
    for step in range(6):
        before = infos["severity"].copy()
        np.testing.assert_array_equal(before, infos["events"][:, 0])
        assert set(before) == {0.25, 0.5, 0.75, 1.0}
        *_, infos = env.step(np.zeros((64, 4)))
        if step % 3 == 2:
            np.testing.assert_array_equal(infos["final_info"]["severity"], before)
            assert (infos["severity"] != before).any()
        else:
            np.testing.assert_array_equal(infos["severity"], before)
    env.close()


def test_bodies_and_severities_share_the_variants(tmp_path: Path) -> None:
    path = robot(tmp_path, EVENTS)
    table = db.compile_class_table(path, severity=(0.5, 1.0), severity_levels=2)
    assert table.variants.names[-1] == "severity"
    assert [row[-1] for row in table.variants.numbers] == [0.5, 1.0, 0.5, 1.0]
    assert len(table.all_models) == 4 * len(table.space.classes)
    with pytest.raises(ConfigError, match="variants = 4 must be a multiple of the 3 levels"):
        db.compile_class_table(path, severity=(0.5, 1.0), severity_levels=3)


def current(folder: Path, events: str = "") -> Path:
    """Write the robot with a joint that jams where it is."""
    path = robot(folder, events)
    path.write_text(path.read_text().replace('"middle"', '"current"'))
    return path


@pytest.mark.parametrize("severity", [1.0, 0.5])
@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("onset", [0, 6])
def test_a_joint_jams_where_it_is_at_the_onset(
    tmp_path: Path, backend: str, onset: int, severity: float
) -> None:
    path = current(tmp_path / "robot")
    table = db.compile_class_table(path, severity=severity)
    both = table.space.parse("jammed_joint@0+jammed_joint@1")
    env = db.make_vec(table, 2, backend=backend, precision="f64", seed=3, onset=onset)
    env.reset(options={"damage_class": np.array([both, table.space.parse("jammed_joint@1")])})
    rng = np.random.default_rng(1)

    def act() -> NDArray[np.float32]:
        return rng.uniform(-1, 1, (2, 4)).astype(np.float32)

    for _ in range(onset):
        env.step(act())
    qpos, qvel = env.get_state()
    knees = [int(table.models[0].joint(f"{side}_knee").qposadr[0]) for side in ("left", "right")]
    worlds = []
    for index, limbs in enumerate(((0, 1), (1,))):
        spec = mujoco.MjSpec.from_string(mjcf())
        for limb in limbs:
            angle = np.clip(qpos[index, knees[limb]], -1.5, -0.2)
            jam = JammedJoint(joint=1, range_deg=0.5, at=math.degrees(angle))
            jam.apply(spec, table.robot.limbs[limb], severity)
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = qpos[index], qvel[index]
        mujoco.mj_forward(model, data)
        worlds.append((model, data))
    saved = None
    for step in range(15):
        if step == 7:
            saved = env.save_state()
        action = act()
        env.step(action)
        for index, (model, data) in enumerate(worlds):
            data.ctrl[:] = 3.0 * action[index].astype(np.float64)
            mujoco.mj_step(model, data, nstep=4)
            for got, expected in zip(env.get_state(), (data.qpos, data.qvel), strict=True):
                # The warm start of the solver differs at the onset.
                np.testing.assert_allclose(got[index], expected, rtol=1e-9, atol=1e-9, err_msg=str(step))
    # A restored robot has jammed where it had.
    assert saved is not None
    last = [env.step(act())[0] for _ in range(3)][-1]
    env.restore_state(saved)
    rng = np.random.default_rng(1)
    [act() for _ in range(onset + 7)]
    again = [env.step(act())[0] for _ in range(8 + 3)][-1]
    np.testing.assert_array_equal(again, last)
    env.close()


def test_backends_agree_about_jammed_joints_and_autoreset(tmp_path: Path) -> None:
    table = db.compile_class_table(current(tmp_path, EVENTS), severity=(0.5, 1.0), severity_levels=2)
    envs = [
        db.make_vec(table, 32, backend=name, precision="f64", seed=5, onset=(0, 9), max_episode_steps=15)
        for name in BACKENDS
    ]
    rng = np.random.default_rng(0)
    for env in envs:
        env.reset()
    for _ in range(40):
        action = rng.uniform(-1, 1, (32, 4)).astype(np.float32)
        for env in envs:
            env.step(action)
        for one, two in zip(*(env.get_state() for env in envs), strict=True):
            np.testing.assert_allclose(one, two, rtol=1e-10, atol=1e-10)
    for env in envs:
        env.close()


def test_a_joint_without_limits_jams_where_it_is_too() -> None:
    spec = mujoco.MjSpec.from_string(mjcf().replace('range="-1.5 -0.2" ref="-0.5"', 'ref="-0.5"'))
    limb = db.load_robot("ant").limbs[0].__class__("left", "left_thigh", ("left_hip", "left_knee"))
    jam = JammedJoint(joint=1, range_deg=0.5, at="current")
    limits = jam.moving_limits(spec, limb, 0.25)
    assert limits is not None
    assert (limits.compiled_at, limits.range, limits.share) == (-0.5, (-math.inf, math.inf), 1.0)
    jam.apply(spec, limb, 0.25)
    shifted = spec.compile().joint("left_knee").range + (2.0 - limits.compiled_at) * limits.share
    other = mujoco.MjSpec.from_string(mjcf().replace('range="-1.5 -0.2" ref="-0.5"', 'ref="-0.5"'))
    JammedJoint(joint=1, range_deg=0.5, at=math.degrees(2.0)).apply(other, limb, 0.25)
    np.testing.assert_allclose(shifted, other.compile().joint("left_knee").range, atol=1e-12)


def test_middle_is_the_middle_of_a_range_that_does_not_contain_zero() -> None:
    options = {"jammed_joint": {"joint": 1, "at": "middle", "range_deg": 0.1}}
    table = db.compile_class_table("ant", types=["jammed_joint"], max_damaged_limbs=1, damage_options=options)
    for limb, item in zip(table.robot.limbs, table.space.classes[1:], strict=True):
        healthy = table.models[0].joint(limb.joints[1]).range
        assert healthy[0] > 0 or healthy[1] < 0
        expected = healthy.mean() + np.radians([-0.1, 0.1])
        np.testing.assert_allclose(table.models[item.id].joint(limb.joints[1]).range, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("events", "message"),
    [
        ("mass = { bodies = 'tail', scale = [1, 2] }", "no body matches 'tail'; the robot has trunk"),
        ("link_length = { bodies = 'trunk', scale = [1, 2] }", "trunk has 2 bodies below it; a link has one"),
        ("mass = { bodies = '(', scale = [1, 2] }", "not a regular expression"),
        ("mass = { bodies = 'trunk', offset = [1, 2] }", "unknown entries offset"),
        ("mass = { bodies = 'trunk', scale = [2, 1] }", "`scale` is a list, expected [low, high]"),
        ("mass = []", "expected a table [mass], or a list of them"),
        ("center_of_mass = { bodies = 'trunk' }", "the entry `offset` is missing"),
        ("variants = 3", "`variants` needs link_length, mass or center_of_mass"),
        ("mass = { bodies = 'trunk', scale = [1, 2] }\nvariants = 1001", "`variants` is 1001"),
    ],
)
def test_wrong_entries_are_refused(tmp_path: Path, events: str, message: str) -> None:
    with pytest.raises(ConfigError) as caught:
        db.compile_class_table(robot(tmp_path, f"[events]\n{events}\n"))
    assert message in str(caught.value)


def test_more_models_than_memory_holds_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = robot(tmp_path, EVENTS)
    size = db.compile_class_table(path, max_damaged_limbs=0).models[0].nbuffer
    monkeypatch.setattr("dappo_batch.model.class_table._MOST_MEMORY", 4 * 9 * size - 1)
    with pytest.raises(ConfigError, match=f"4 variants of 9 damage classes of {size} bytes each need"):
        db.compile_class_table(path)


@pytest.mark.parametrize(
    "severity", [(0.5,), (0.5, 0.5), (0.0, 1.0), (0.5, 1.5), (0.2, 0.4, 1.0), "full", (0.5, math.nan)]
)
def test_wrong_severities_are_refused(severity: Any) -> None:  # noqa: ANN401
    with pytest.raises(ConfigError, match="severity"):
        db.compile_class_table("ant", severity=severity)


def test_check_prints_the_variants(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = robot(tmp_path, EVENTS)
    report = db.check_robot(path)
    table = db.compile_class_table(path)
    assert report.variant_names == tuple(NAMES)
    assert report.variants == table.variants.numbers
    assert (report.models, report.model_bytes) == (len(table.all_models), table.nbytes)
    from dappo_batch.commands.check import command

    nothing = dict.fromkeys(("types", "max_damaged_limbs", "max_damages_per_limb", "picture"))
    command(robot=str(path), **nothing, json=False)
    printed = capsys.readouterr().out
    assert f"4 compiled variants of each damage class: {len(table.all_models)} models" in printed
    assert f"{table.variants.numbers[2][0]:.6g}" in printed


POST = """
name = "post"
mjcf = "post.xml"
main_body = "trunk"
frame_skip = 4
max_episode_steps = 1000
limbs = [{ name = "leg", body = "link", joints = ["hip", "knee"] }]
damage = { types = [], max_damaged_limbs = 0 }
actions = { type = "control", scale = 1.0 }
reset = { qpos_noise = 0.0, qvel_noise = 0.0 }
observation.policy.terms = [{ term = "qpos" }]
rewards.survive.weight = 1.0
terminations.height = [-inf, inf]
"""


def post_mjcf(factor: float = 1.0) -> str:
    """Return a robot whose link has geoms of all shapes, stretched about its joint 10 cm above its origin."""

    def z(value: float) -> float:
        return 0.1 + factor * (value - 0.1)

    middle, half = np.array([0.01, 0, z(-0.05)]), factor * np.array([0.01, 0, -0.05])
    slanted = " ".join(map(repr, map(float, [*(middle - half), *(middle + half)])))
    round_end = 4 / 3 * 0.02
    capsule = 0.2 * (0.2 * factor + round_end) / (0.2 + round_end)
    return f"""
<mujoco>
  <default><geom contype="0" conaffinity="0"/></default>
  <worldbody>
    <geom name="floor" type="plane" size="9 9 1" contype="1"/>
    <body name="trunk" pos="0 0 1">
      <freejoint/>
      <geom size="0.1" mass="1"/>
      <body name="link">
        <joint name="hip" pos="0 0 0.1" axis="0 1 0"/>
        <geom type="capsule" size="0.02 {0.1 * factor}" pos="0.05 0 {z(-0.1)}" mass="{capsule}"/>
        <geom type="cylinder" size="0.03 0.05" pos="0 0 {z(-0.12)}" euler="0 90 0" mass="0.1"/>
        <geom type="box" size="0.01 0.02 {0.06 * factor}" pos="0 0 {z(-0.2)}" euler="0 30 0"
          mass="{0.3 * factor}"/>
        <geom type="ellipsoid" size="0.01 {0.03 * factor} 0.02" pos="0 0.02 {z(0)}" euler="90 0 0"/>
        <geom type="cylinder" size="0.01" fromto="{slanted}"/>
        <geom type="sphere" size="0.02" pos="0 0 {z(-0.25)}"/>
        <site name="mark" pos="0.01 0 {z(-0.25)}"/>
        <body name="end" pos="0 0 {z(-0.3)}">
          <joint name="knee" pos="0 0 0.02" axis="0 1 0"/>
          <geom type="sphere" size="0.03" conaffinity="1"/>
        </body>
      </body>
    </body>
  </worldbody>
  <actuator><motor joint="hip"/></actuator>
</mujoco>
"""


def post(folder: Path, events: str, text: str) -> ClassTable:
    """Compile the post with events."""
    (folder / "post.toml").write_text(POST + events)
    (folder / "post.xml").write_text(text)
    return db.compile_class_table(folder / "post.toml")


def test_geoms_of_all_shapes_are_stretched_about_the_joint(tmp_path: Path) -> None:
    events = "[events]\nvariants = 2\nlink_length = { bodies = 'link', scale = [0.6, 1.7] }\n"
    table = post(tmp_path, events, post_mjcf())
    for (factor,), model in zip(table.variants.numbers, table.all_models, strict=True):
        expected = arrays(post(tmp_path, "", post_mjcf(factor)).models[0])
        for name, got in arrays(model).items():
            np.testing.assert_allclose(got, expected[name], rtol=1e-10, atol=1e-13, err_msg=name)


def test_the_centre_of_mass_of_geoms_moves_and_their_inertia_remains(tmp_path: Path) -> None:
    events = "[events]\nvariants = 2\ncenter_of_mass = { bodies = 'link', offset = [-0.05, 0.05] }\n"
    healthy = post(tmp_path, "", post_mjcf()).models[0]
    table = post(tmp_path, events, post_mjcf())
    link = healthy.body("link").id
    for offset, model in zip(table.variants.numbers, table.all_models, strict=True):
        np.testing.assert_allclose(model.body_ipos[link], healthy.body_ipos[link] + offset, atol=1e-14)
        np.testing.assert_allclose(inertia(model, link), inertia(healthy, link), rtol=1e-10, atol=1e-16)
        np.testing.assert_allclose(model.body_mass, healthy.body_mass, rtol=1e-14)


def inertia(model: mujoco.MjModel, body: int) -> Array:
    """Return the inertia tensor of a body in its own axes."""
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.body_iquat[body])
    turn = axes.reshape(3, 3)
    tensor: Array = turn @ np.diag(model.body_inertia[body]) @ turn.T
    return tensor


LENGTH = "link_length = { bodies = 'link', scale = [1, 2] }"


@pytest.mark.parametrize(
    ("events", "old", "new", "message"),
    [
        (LENGTH, "<mujoco>", '<mujoco><compiler settotalmass="5"/>', "sets the total mass (settotalmass)"),
        (
            LENGTH,
            "<actuator>",
            '<equality><connect body1="link" body2="end" anchor="0 0 0"/></equality><actuator>',
            "an equality constraint is attached to body link",
        ),
        (LENGTH, 'name="knee" pos="0 0 0.02"', 'name="knee" pos="0 0 0.4"', "body link has no length"),
        (
            "center_of_mass = { bodies = 'empty', offset = [0, 1] }",
            '<site name="mark"',
            '<body name="empty"/><site name="mark"',
            "body empty has no mass",
        ),
    ],
)
def test_bodies_that_cannot_change_are_refused(
    tmp_path: Path, events: str, old: str, new: str, message: str
) -> None:
    text = post_mjcf()
    assert old in text
    with pytest.raises(ConfigError) as caught:
        post(tmp_path, f"[events]\n{events}\n", text.replace(old, new, 1))
    assert message in str(caught.value)


@pytest.mark.skipif(importlib.util.find_spec("warp") is None, reason="needs the extra gpu")
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"severity": (0.5, 1.0)}, "a range of damage.severity"),
        ({"damage_options": {"jammed_joint": {"at": "current"}}}, 'follows from the onset (at = "current")'),
    ],
)
def test_the_kernels_refuse_variants(options: dict[str, Any], message: str) -> None:
    table = db.compile_class_table("ant", types=["jammed_joint"], max_damaged_limbs=1, **options)
    with pytest.raises(ConfigError) as caught:
        db.make_vec(table, 2, device="warp-cpu")
    assert message in str(caught.value)


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_training_with_variants_resumes_exactly(tmp_path: Path, backend: str) -> None:
    path = current(tmp_path / "robot", EVENTS)
    settings: dict[str, Any] = {
        "robot": str(path),
        "num_envs": 8,
        "seed": 3,
        "threads": 1,
        "set": {
            **{"horizon": 16, "ppo.hidden": [8], "checkpoint.every": 1, "evaluation.episodes": 1},
            **{"env.max_episode_steps": 12, "env.backend": backend, "env.precision": "f64"},
            "damage": {
                **{"severity": [0.5, 1.0], "severity_levels": 2, "max_damaged_limbs": 1},
                "onset": {"first": 0, "last": 8},
            },
        },
    }
    whole = db.train(tmp_path / "whole", total_steps=4 * 128, **settings)
    part = db.train(tmp_path / "part", total_steps=2 * 128, **settings)
    # The robot is that of the run folder from here on.
    path.unlink()
    resumed = db.resume(part.path, total_steps=4 * 128)
    times = {"unix_seconds", "rollout_seconds", "update_seconds"}
    for column, values in whole.metrics.items():
        if column not in times:
            np.testing.assert_array_equal(resumed.metrics[column], values, err_msg=column)
    assert whole.metrics["env_steps"][-1] == 512
