"""Missing shanks and limbs: what remains weighs, measures and moves as it should."""

from __future__ import annotations

import math
from dataclasses import replace

import mujoco
import numpy as np
import pytest

import dappo_batch
from dappo_batch._core import ConfigError
from dappo_batch.damage import DAMAGE_TYPES, MissingLimb, MissingShank, make_damage_type
from dappo_batch.robots import load_robot

from .damaged_limbs import LIMB, ONE, assert_equal_models, limb, numeric_differences

STUMP = MissingShank(half_length=0.01)


def places(spec: mujoco.MjSpec, kind: str, name: str) -> np.ndarray:
    """Return where something is relative to the knee."""
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return np.asarray(getattr(data, kind)(name).xpos - data.joint("knee").xanchor)


FEET = {
    "ball": ('<geom name="foot" size="0.05" pos="0 0 -0.4"/>', 1000 * 4 / 3 * math.pi * 0.05**3),
    "ball of a given mass": ('<geom name="foot" size="0.05" pos="0.02 0 -0.45" mass="0.3"/>', 0.3),
    "box in a body of its own": (
        '<body pos="0 0 -0.4"><geom name="foot" type="box" size="0.05 0.03 0.01"/></body>',
        1000 * 8 * 0.05 * 0.03 * 0.01,
    ),
    "capsule across": (
        '<geom name="foot" type="capsule" fromto="-0.1 0 -0.4 0.1 0 -0.4" size="0.02"/>',
        1000 * math.pi * 0.02**2 * (0.2 + 4 / 3 * 0.02),
    ),
}
"""Feet at the end of the lower segment, and their masses."""


@pytest.mark.parametrize("foot", FEET)
@pytest.mark.parametrize("severity", [0.5, 1.0])
def test_a_foot_shrinks_into_the_joint(foot: str, severity: float) -> None:
    end, weight = FEET[foot]
    sound, spec = limb(end), limb(end)
    STUMP.apply(spec, ONE, severity)
    factor = 1 - 0.999 * severity
    assert places(spec, "geom", "foot") == pytest.approx(factor * places(sound, "geom", "foot"), abs=1e-12)
    before, after = sound.compile(), spec.compile()
    assert after.geom("foot").size == pytest.approx(factor * before.geom("foot").size)
    lost = severity * (0.4 - 0.02)
    mass = 1000 * math.pi * 0.03**2 * (0.4 - lost + 4 / 3 * 0.03) + factor**3 * weight
    assert after.body("shank").subtreemass == pytest.approx(mass)
    assert places(spec, "site", "ankle") == pytest.approx([0, 0, -0.4 + lost], abs=1e-12)


def test_a_missing_foot_does_not_touch_the_floor() -> None:
    end = '<geom name="foot" size="0.05" pos="0 0 -0.4"/>'
    touching = []
    for damage in (None, STUMP):
        spec = limb(end)
        spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1])
        if damage:
            damage.apply(spec, ONE, 1.0)
        model = spec.compile()
        data = mujoco.MjData(model)
        # The knee is 0.04 m above the floor: the stump reaches 0.05 m below it, the healthy foot 0.45 m.
        data.qpos[2] = 0.04
        mujoco.mj_forward(model, data)
        named = {model.geom(int(geom)).name for geom in data.contact.geom.flatten()}
        touching.append({"toe", "foot"} & named)
    assert touching == [{"toe", "foot"}, {"toe"}]


def test_a_foot_that_alone_touches_the_floor_becomes_the_end_of_the_stump() -> None:
    end = '<geom name="foot" size="0.05" pos="0 0 -0.4"/>'
    spec = limb(end)
    spec.geom("toe").contype = spec.geom("toe").conaffinity = 0
    STUMP.apply(spec, ONE, 1.0)
    assert places(spec, "geom", "foot") == pytest.approx([0, 0, -0.02], abs=1e-12)
    assert spec.compile().geom("foot").size[0] == pytest.approx(0.05 * 0.02 / 0.4)


# A shank of the limb instead of a capsule, and the same shortened by hand to 0.04 m.
SHANKS = {
    "box": (
        'type="box" size="0.02 0.03 0.2" pos="0 0 -0.2"',
        'type="box" size="0.02 0.03 0.02" pos="0 0 -0.02"',
    ),
    "turned box": (
        'type="box" size="0.2 0.03 0.02" pos="0 0 -0.2" euler="0 1.5707963267948966 0"',
        'type="box" size="0.02 0.03 0.02" pos="0 0 -0.02" euler="0 1.5707963267948966 0"',
    ),
    "box of a given mass": (
        'type="box" fromto="0 0 0 0 0 -0.4" size="0.02" mass="3"',
        'type="box" fromto="0 0 0 0 0 -0.04" size="0.02" mass="0.3"',
    ),
    "cylinder": (
        'type="cylinder" size="0.02 0.2" pos="0 0 -0.2" mass="3"',
        'type="cylinder" size="0.02 0.02" pos="0 0 -0.02" mass="0.3"',
    ),
    "cylinder between two points": (
        'type="cylinder" fromto="0 0 -0.4 0 0 0" size="0.02"',
        'type="cylinder" fromto="0 0 -0.04 0 0 0" size="0.02"',
    ),
    "ellipsoid": (
        'type="ellipsoid" size="0.02 0.03 0.2" pos="0 0 -0.2"',
        'type="ellipsoid" size="0.02 0.03 0.02" pos="0 0 -0.02"',
    ),
    "capsule": (
        'type="capsule" size="0.02 0.2" pos="0 0 -0.2"',
        'type="capsule" size="0.02 0.02" pos="0 0 -0.02"',
    ),
}
TOE = 'type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03"'


@pytest.mark.parametrize("shape", SHANKS)
@pytest.mark.parametrize("toe", ["toe", None])
def test_a_shank_of_any_shape_equals_one_that_is_shortened_by_hand(shape: str, toe: str | None) -> None:
    sound, short = SHANKS[shape]
    text = LIMB.format(end="", extra="<contact/>", joint="")
    assert text.count(TOE) == text.count(' pos="0 0 -0.4"') == 1
    spec = mujoco.MjSpec.from_string(text.replace(TOE, sound))
    MissingShank(half_length=0.02).apply(spec, replace(ONE, toe_geom=toe), 1.0)
    by_hand = text.replace(TOE, short).replace(' pos="0 0 -0.4"', ' pos="0 0 -0.04"')
    model, expected = spec.compile(), mujoco.MjModel.from_xml_string(by_hand)
    assert_equal_models(model, expected)


def test_the_default_stump_is_a_tenth_of_the_segment() -> None:
    stumps = []
    for type_ in (MissingShank(), MissingShank(half_length=0.02)):
        spec = limb()
        type_.apply(spec, ONE, 1.0)
        stumps.append(spec.compile())
    assert_equal_models(*stumps)


INERTIAL = '<inertial pos="{pos}" mass="{mass}" fullinertia="{tensor}"/>'


def of_points(masses: np.ndarray, points: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, center and inertia tensor of point masses."""
    mass = masses.sum()
    center = masses @ points / mass
    arms = points - center
    squares = np.einsum("n,ni,nj->ij", masses, arms, arms)
    return float(mass), center, np.trace(squares) * np.eye(3) - squares


def test_the_mass_of_an_inertial_contracts_along_the_segment() -> None:
    rng = np.random.default_rng(0)
    masses, points = rng.uniform(0.01, 0.1, 12), rng.normal([0.01, 0.02, -0.15], 0.05, (12, 3))
    mass, center, tensor = of_points(masses, points)
    components = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    texts = (" ".join(map(repr, map(float, numbers))) for numbers in (center, components))
    pos, full = texts
    spec = limb(INERTIAL.format(pos=pos, mass=mass, tensor=full))
    MissingShank(half_length=0.05).apply(spec, ONE, 0.8)
    # The length goes from 0.4 to 0.1 m, at this severity to 0.16: each point keeps 0.4 of mass and height.
    mass, center, tensor = of_points(0.4 * masses, points * [1, 1, 0.4])
    body = spec.compile().body("shank")
    turn = np.zeros(9)
    mujoco.mju_quat2Mat(turn, body.iquat)
    turn = turn.reshape(3, 3)
    assert body.mass == pytest.approx(mass, rel=1e-12)
    assert body.ipos == pytest.approx(center, rel=1e-12)
    assert turn @ np.diag(body.inertia) @ turn.T == pytest.approx(tensor, rel=1e-9, abs=1e-15)


def test_a_uniform_rod_with_an_inertial_becomes_a_shorter_rod() -> None:
    rods = []
    for length, mass in ((0.4, 0.5), (0.1, 0.125)):
        moment = mass * length**2 / 12
        rods.append(
            f'<inertial pos="0 0 {-length / 2}" mass="{mass}"'
            f' diaginertia="{moment + 1e-5 * mass} {moment + 1e-5 * mass} {2e-5 * mass}"/>'
        )
    spec = limb(rods[0])
    MissingShank(half_length=0.05).apply(spec, ONE, 1.0)
    body, expected = spec.compile().body("shank"), limb(rods[1]).compile().body("shank")
    assert (body.mass, body.ipos) == (pytest.approx(expected.mass), pytest.approx(expected.ipos, abs=1e-12))
    assert body.inertia == pytest.approx(expected.inertia)


PLATE = """<mesh name="plate" vertex="-.02 -.03 0  .02 -.03 0  .02 .03 0  -.02 .03 0
  -.02 -.03 -.4  .02 -.03 -.4  .02 .03 -.4  -.02 .03 -.4"/>"""
"""A box of 0.04 by 0.06 by 0.4 m."""


def with_plate(geom: str) -> mujoco.MjSpec:
    plate = f'<geom name="cover" type="mesh" mesh="plate" pos="0 0 0.1" euler="0 0 1" {geom}/>'
    text = LIMB.format(end=plate, extra="", joint="")
    text = text.replace("<worldbody>", f"<asset>{PLATE}</asset><worldbody>")
    return mujoco.MjSpec.from_string(text)


def test_a_mesh_without_contacts_becomes_invisible() -> None:
    sound = with_plate('contype="0" conaffinity="0" mass="0"')
    spec = sound.copy()
    STUMP.apply(spec, ONE, 1.0)
    assert spec.compile().geom("cover").rgba[3] == 0
    assert spec.compile().body("shank").mass < sound.compile().body("shank").mass


def test_a_mesh_with_contacts_and_mass_becomes_a_shorter_capsule() -> None:
    sound = with_plate("")
    spec = sound.copy()
    spec.geom("toe").contype = spec.geom("toe").conaffinity = 0
    MissingShank(half_length=0.05).apply(spec, ONE, 1.0)
    model = spec.compile()
    geom = model.geom("cover")
    assert geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE
    # As thick as the plate, from 0.02 m below the upper end of that, which is 0.1 m above the knee.
    assert geom.size[:2] == pytest.approx([0.02, 0.09])
    assert geom.pos == pytest.approx([0, 0, -0.01], abs=1e-8)
    assert model.body("shank").mass == pytest.approx(0.25 * sound.compile().body("shank").mass)


def test_masses_of_other_bodies_remain_where_the_mjcf_ignores_inertials() -> None:
    text = LIMB.format(end='<geom name="cover" type="mesh" mesh="plate"/>', extra="", joint="")
    text = text.replace("<worldbody>", f"<asset>{PLATE}</asset><worldbody>")
    text = text.replace('angle="radian"', 'angle="radian" inertiafromgeom="true"')
    text = text.replace("<freejoint/>", '<freejoint/><inertial pos="0 0 0" mass="7" diaginertia="1 1 1"/>')
    spec = mujoco.MjSpec.from_string(text)
    STUMP.apply(spec, ONE, 1.0)
    sound, model = mujoco.MjModel.from_xml_string(text), spec.compile()
    assert model.body("torso").mass == sound.body("torso").mass != 7
    assert model.body("shank").mass == pytest.approx(0.05 * sound.body("shank").mass)


def test_missing_toe_is_another_name_of_missing_shank() -> None:
    tables = [
        dappo_batch.compile_class_table(
            "ant", types=[name], max_damaged_limbs=1, damage_options={name: {"half_length": 0.005}}
        )
        for name in ("missing_toe", "missing_shank")
    ]
    assert [entry.name for entry in tables[1].space.classes] == [
        entry.name.replace("missing_toe", "missing_shank") for entry in tables[0].space.classes
    ]
    for toe, shank in zip(tables[0].models, tables[1].models, strict=True):
        assert numeric_differences(toe, shank) == set()
    with pytest.raises(ConfigError, match="missing_toe and missing_shank are two names of the same"):
        dappo_batch.compile_class_table("ant", types=["missing_toe", "missing_shank"])


def test_what_lies_on_the_stump_stays_there() -> None:
    spec = limb('<geom name="knee" size="0.05" pos="0 0 0.02"/>')
    STUMP.apply(spec, ONE, 1.0)
    assert places(spec, "geom", "knee") == pytest.approx([0, 0, 0.02])


def test_other_geoms_along_the_segment_are_shortened_with_it() -> None:
    spec = limb(
        '<geom name="cover" type="box" size="0.04 0.04 0.2" pos="0 0 -0.2" contype="0" conaffinity="0"'
        ' mass="0"/>'
        '<body><geom name="shin" type="capsule" fromto="0.01 0 0.1 0.01 0 -0.3" size="0.04"/></body>'
    )
    MissingShank(half_length=0.05).apply(spec, ONE, 1.0)
    model = spec.compile()
    assert (model.geom("cover").size, model.geom("cover").pos) == (
        pytest.approx([0.04, 0.04, 0.05]),
        pytest.approx([0, 0, -0.05]),
    )
    assert (model.geom("shin").size[:2], model.geom("shin").pos) == (
        pytest.approx([0.04, 0.1]),
        pytest.approx([0.01, 0, 0]),
    )


@pytest.mark.parametrize(
    ("end", "extra", "message"),
    [
        (
            '<body pos="0 0 -0.4"><joint name="heel"/><geom size="0.05"/></body>',
            "",
            "joint heel is below geom toe, so that is not the lowest",
        ),
        (
            "",
            '<equality><connect body1="shank" body2="torso" anchor="0 0 -0.4"/></equality>',
            "an equality constraint is attached to body shank",
        ),
        (
            "",
            '<tendon><spatial name="rope"><site site="hub"/><site site="ankle"/></spatial></tendon>',
            "tendon rope is attached to body shank",
        ),
        (
            '<frame><geom name="foot" size="0.05" pos="0 0 -0.4"/></frame>',
            "",
            "foot breaks off and lies in a <frame>",
        ),
    ],
)
def test_a_toe_that_cannot_break_off_alone_is_rejected(end: str, extra: str, message: str) -> None:
    spec = limb(end, extra if extra else "<contact/>")
    with pytest.raises(ConfigError, match=message):
        STUMP.apply(spec, ONE, 1.0)


def test_a_toe_that_carries_nothing_but_is_held_by_a_constraint_is_rejected() -> None:
    text = LIMB.format(
        end="",
        extra='<equality><connect body1="shank" body2="torso" anchor="0 0 -0.4"/></equality>',
        joint="",
    )
    spec = mujoco.MjSpec.from_string(text.replace('<site name="ankle" pos="0 0 -0.4"/>', ""))
    with pytest.raises(ConfigError, match="an equality constraint is attached to body shank"):
        STUMP.apply(spec, ONE, 1.0)


def test_a_robot_whose_total_mass_is_set_cannot_lose_any() -> None:
    spec = limb()
    spec.compiler.settotalmass = 10
    with pytest.raises(ConfigError, match="settotalmass"):
        STUMP.apply(spec, ONE, 1.0)


def capsule(length: float) -> float:
    """Return the mass of a capsule with the radius and density of both segments of the limb."""
    return 1000 * math.pi * 0.03**2 * (length + 4 / 3 * 0.03)


def test_a_missing_limb_weighs_its_stump() -> None:
    spec = limb(FEET["ball"][0])
    MissingLimb().apply(spec, ONE, 1.0)
    model = spec.compile()
    assert model.body("limb").mass == pytest.approx(capsule(0.03))
    assert model.body("shank").mass == pytest.approx(1e-4 * (capsule(0.4) + FEET["ball"][1]))
    # The knee is at the end of the stump.
    assert model.body("shank").pos == pytest.approx([0.03, 0, 0])
    assert model.geom("toe").size[:2] == pytest.approx([0.03e-3, 0.2e-3])
    healthy = limb(FEET["ball"][0]).compile()
    for body in ("torso", "other"):
        assert model.body(body).mass == healthy.body(body).mass


MOTORS = """<contact/><actuator><motor name="hip" joint="hip" gear="9"/>
  <position name="knee" joint="knee" kp="7"/><motor name="elbow" joint="elbow"/></actuator>"""


def test_a_robot_with_a_missing_limb_moves_like_one_without_it() -> None:
    spec = limb(extra=MOTORS)
    MissingLimb().apply(spec, ONE, 1.0)
    model = spec.compile()
    # By hand: a stump without a knee, whose hip has the inertia of the healthy limb as armature.
    armature = float(limb(extra=MOTORS).compile().dof_M0[6])
    text = LIMB.format(end="", extra='<actuator><motor joint="elbow"/></actuator>', joint="")
    shank = text[text.index('<body name="shank"') : text.index("</body></body>")] + "</body>"
    text = text.replace(shank, "").replace("0 0 0 0.3 0 0", "0 0 0 0.03 0 0")
    text = text.replace('name="hip"', f'name="hip" armature="{armature!r}"')
    by_hand = mujoco.MjModel.from_xml_string(text)
    assert (by_hand.nv, model.nv) == (8, 9)
    rng = np.random.default_rng(0)
    kept = [*range(7), 8]  # without the knee
    for _ in range(10):
        qvel, ctrl, angles = rng.normal(size=9), rng.normal(size=3), rng.uniform(-0.9, 0.9, 3)
        accelerations = []
        for item, dofs, motors in ((model, range(9), range(3)), (by_hand, kept, [2])):
            data = mujoco.MjData(item)
            data.qvel[:], data.ctrl[:] = qvel[dofs], ctrl[motors]
            data.qpos[7:] = angles[[dof - 6 for dof in dofs if dof >= 6]]
            mujoco.mj_forward(item, data)
            accelerations.append(data.qacc.copy())
        # Apart from the ten-thousandth of the shank's mass.
        assert accelerations[0][kept] == pytest.approx(accelerations[1], rel=2e-3, abs=2e-3)


def test_actuators_of_a_missing_limb_give_nothing_and_all_others_work() -> None:
    spec = limb(extra=MOTORS)
    MissingLimb().apply(spec, ONE, 1.0)
    model = spec.compile()
    data = mujoco.MjData(model)
    data.ctrl[:] = 0.5
    mujoco.mj_forward(model, data)
    assert data.actuator_force.tolist() == [0, 0, 0.5]


def test_a_missing_limb_touches_the_floor_but_not_the_robot() -> None:
    counts = []
    for height in (5.0, -0.01):
        spec = limb()
        floor = spec.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1])
        # The torso would hold the whole stump.
        spec.body("torso").geoms[0].size = [0.2, 0, 0]
        MissingLimb().apply(spec, ONE, 1.0)
        model = spec.compile()
        data = mujoco.MjData(model)
        data.qpos[2] = height
        mujoco.mj_forward(model, data)
        names = [{model.geom(int(geom)).name for geom in pair} for pair in data.contact.geom]
        counts.append(sum("toe" in pair for pair in names))
        assert floor.name == "floor"
        assert all("floor" in pair for pair in names if "toe" in pair)
    assert counts[0] == 0
    assert counts[1] > 0


def test_a_missing_limb_needs_a_free_bit_of_the_masks_if_the_robot_touches_itself() -> None:
    spec = limb()
    spec.geom("toe").contype = 2**31 - 1
    with pytest.raises(ConfigError, match="use all 31 bits of contype"):
        MissingLimb().apply(spec, ONE, 1.0)


@pytest.mark.parametrize("name", DAMAGE_TYPES)
def test_slight_damage_is_close_to_none(name: str) -> None:
    robot = load_robot("hexapod")
    kind = make_damage_type(name, {"half_length": 0.01} if name == "missing_toe" else {})
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    healthy = spec.compile()
    kind.apply(spec, robot.limbs[0], 1e-6)
    model = spec.compile()
    # Principal axes of a round body are arbitrary.
    for array in numeric_differences(healthy, model) - {"body_iquat"}:
        got, want = np.asarray(getattr(model, array)), np.asarray(getattr(healthy, array))
        if want.dtype.kind == "f":  # integers are choices of the compiler, such as frames that coincide
            got, want = (np.abs(values) if array.endswith("quat") else values for values in (got, want))
            assert got == pytest.approx(want, rel=1e-4, abs=1e-5), array


@pytest.mark.parametrize("name", ["missing_shank", "missing_limb", "dead_motor"])
@pytest.mark.parametrize("backend", ["lanes", "mujoco"])
def test_damaged_robots_of_the_paper_walk_on_all_backends(name: str, backend: str) -> None:
    for robot in ("ant", "hexapod"):
        table = dappo_batch.compile_class_table(robot, types=[name], max_damaged_limbs=2)
        envs = dappo_batch.make_vec(table, num_envs=8, backend=backend, damage="uniform", seed=0)
        envs.reset()
        for _ in range(50):
            obs, reward, *_ = envs.step(np.ones((8, table.models[0].nu), dtype=np.float32))
        assert np.isfinite(obs).all()
        assert np.isfinite(reward).all()
        envs.close()
