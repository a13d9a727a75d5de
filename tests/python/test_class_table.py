"""The class table: every class compiled, of equal sizes, and physically the MJCF it came from."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np
import pytest

from dappo_batch._core import ConfigError
from dappo_batch.damage import DAMAGE_TYPES, DamageType, make_damage_type
from dappo_batch.model import ClassTable, ClassTableError, class_table, compile_class_table
from dappo_batch.model.floor_pairs import make_floor_contacts_explicit
from dappo_batch.robots import Limb, Robot, load_robot

TRIPOD = Path(__file__).parent / "robots" / "tripod.toml"
CLASSES = {
    "ant": [
        "healthy",
        "jammed_joint@0",
        "missing_toe@2",
        "missing_toe@1+jammed_joint@3",
        "missing_toe@0+missing_toe@1",
    ],
    "hexapod": ["healthy", "missing_toe@0", "jammed_joint@4", "jammed_joint@1+missing_toe@2"],
    str(TRIPOD): ["healthy", "missing_toe@0+jammed_joint@1+missing_toe@2"],
}


@pytest.fixture(scope="module")
def tables() -> dict[str, ClassTable]:
    return {name: compile_class_table(name) for name in CLASSES}


def unmodified_model(table: ClassTable, class_id: int) -> mujoco.MjModel:
    """Compile a class from the MJCF with its own contacts and flags."""
    robot = table.robot
    spec = mujoco.MjSpec.from_file(str(robot.mjcf_path))
    for limb, name in table.space.classes[class_id].damages:
        make_damage_type(name, robot.damage_options(name)).apply(spec, robot.limbs[limb], table.severity)
    return spec.compile()


def largest_difference(
    a: mujoco.MjModel, b: mujoco.MjModel, steps: int, frame_skip: int
) -> tuple[float, int]:
    """Return the largest difference of states and contact forces, and the number of steps with contact."""
    rng = np.random.default_rng(7)
    data = [mujoco.MjData(a), mujoco.MjData(b)]
    noise = rng.uniform(-0.02, 0.02, a.nq)
    difference, touched = 0.0, 0
    for item in data:
        item.qpos[:] += noise
    for _ in range(steps):
        ctrl = rng.uniform(a.actuator_ctrlrange[:, 0], a.actuator_ctrlrange[:, 1])
        for model, item in zip((a, b), data, strict=True):
            item.ctrl[:] = ctrl
            mujoco.mj_step(model, item, nstep=frame_skip)
            mujoco.mj_rnePostConstraint(model, item)
        for field in ("qpos", "qvel", "cfrc_ext", "sensordata"):
            values = [np.asarray(getattr(item, field)) for item in data]
            difference = max(difference, float(np.max(np.abs(values[0] - values[1]), initial=0.0)))
        assert data[0].ncon == data[1].ncon
        touched += data[0].ncon > 0
    return difference, touched


@pytest.mark.parametrize(
    ("name", "damage"), [(name, item) for name, items in CLASSES.items() for item in items]
)
def test_explicit_floor_contacts_change_nothing_over_1000_random_steps(
    tables: dict[str, ClassTable], name: str, damage: str
) -> None:
    table = tables[name]
    class_id = table.space.parse(damage)
    model, reference = table.models[class_id], unmodified_model(table, class_id)
    assert model.npair == model.ngeom - 1
    assert reference.npair == 0
    assert model.opt.disableflags & mujoco.mjtDisableBit.mjDSBL_ISLAND
    difference, touched = largest_difference(model, reference, 1000, table.robot.spec["frame_skip"])
    assert difference == 0.0
    assert touched > 300


def test_explicit_floor_contacts_carry_the_parameters_that_mujoco_mixes(
    tables: dict[str, ClassTable],
) -> None:
    model = tables["ant"].models[0]
    assert np.all(model.pair_margin == 0.02)  # margins of 0.01 add up
    assert np.all(model.pair_friction == [1, 1, 0.5, 0.5, 0.5])
    assert np.all(model.pair_dim == 3)


@pytest.mark.parametrize(
    ("floor", "ball"),
    [
        ('priority="1" friction="0.3 0.2 0.1" condim="6"', 'friction="0.9 0.1 0.3" solref="0.05 1.5"'),
        ('solmix="3" solref="0.01 1"', 'solmix="1" solref="0.04 0.5" solimp="0.8 0.9 0.01 0.5 2"'),
        ('condim="1" margin="0.03"', 'condim="4" margin="0.002" friction="2"'),
    ],
)
def test_mixing_follows_priority_weights_and_margins(floor: str, ball: str) -> None:
    mjcf = f"""<mujoco><worldbody>
        <geom type="plane" size="5 5 1" conaffinity="1" contype="0" {floor}/>
        <body pos="0 0 0.25">
          <freejoint/><geom type="capsule" size="0.1 0.2" euler="30 40 0" conaffinity="0" {ball}/>
        </body>
        </worldbody></mujoco>"""
    spec = mujoco.MjSpec.from_string(mjcf)
    assert make_floor_contacts_explicit(spec)
    model, reference = spec.compile(), mujoco.MjModel.from_xml_string(mjcf)
    assert model.npair == 1
    data = [mujoco.MjData(model), mujoco.MjData(reference)]
    contacts = 0
    for _ in range(400):
        mujoco.mj_step(model, data[0])
        mujoco.mj_step(reference, data[1])
        contacts += data[1].ncon
        assert np.array_equal(data[0].qpos, data[1].qpos)
    assert contacts > 100


@pytest.mark.parametrize(
    ("floor", "robot", "extra"),
    [
        ("", "", ""),  # MuJoCo's default masks: everything touches everything
        ("", 'conaffinity="0" gap="0.01"', ""),
        ("", 'conaffinity="0"', '<contact><exclude body1="world" body2="b"/></contact>'),
        ("", 'conaffinity="0"', '<contact><pair geom1="floor" geom2="g"/></contact>'),
        ("", 'conaffinity="0"', '<option><flag override="enable"/></option>'),
    ],
)
def test_a_robot_with_other_contacts_keeps_them_as_they_are(floor: str, robot: str, extra: str) -> None:
    spec = mujoco.MjSpec.from_string(
        f"""<mujoco>{extra}<worldbody><geom name="floor" type="plane" size="5 5 1" {floor}/>
        <body name="b" pos="0 0 1"><freejoint/><geom name="g" size="0.1" {robot}/>
        </body></worldbody></mujoco>"""
    )
    pairs = len(spec.pairs)
    assert not make_floor_contacts_explicit(spec)
    model = spec.compile()
    assert model.npair == pairs
    assert model.geom("g").contype == 1
    assert model.opt.disableflags == 0


def test_exclusions_that_exclude_nothing_change_nothing_but_the_speed() -> None:
    mjcf = """<mujoco><worldbody><geom name="floor" type="plane" size="5 5 1"/>
        <body name="b" pos="0 0 0.3"><freejoint/><geom size="0.1" conaffinity="0"/>
          <body name="c" pos="0.2 0 0"><joint axis="0 1 0"/>
            <geom size="0.1 0.1" type="capsule" conaffinity="0"/></body>
        </body></worldbody>
        <contact><exclude body1="b" body2="c"/></contact></mujoco>"""
    spec = mujoco.MjSpec.from_string(mjcf)
    assert make_floor_contacts_explicit(spec)
    model, reference = spec.compile(), mujoco.MjModel.from_xml_string(mjcf)
    assert (model.npair, reference.npair) == (2, 0)
    data = [mujoco.MjData(model), mujoco.MjData(reference)]
    contacts = 0
    for _ in range(400):
        for item, own in zip(data, (model, reference), strict=True):
            mujoco.mj_step(own, item)
        contacts += data[1].ncon
        assert np.array_equal(data[0].qpos, data[1].qpos)
    assert contacts > 100


def test_the_paper_has_33_and_73_classes(tables: dict[str, ClassTable]) -> None:
    assert len(tables["ant"].models) == 33
    assert len(tables["hexapod"].models) == 73


def test_a_state_of_one_class_fits_every_other(tables: dict[str, ClassTable]) -> None:
    for table in tables.values():
        first, second = table.worker_data(2)
        assert first is not second
        for model in table.models:
            mujoco.mj_step(model, first)
            assert np.all(np.isfinite(first.qpos))
            assert mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION) == mujoco.mj_stateSize(
                table.models[0], mujoco.mjtState.mjSTATE_INTEGRATION
            )


def test_touch_sensors_of_limbs_without_a_toe_are_disabled(tables: dict[str, ClassTable]) -> None:
    table = tables["hexapod"]
    disabled = {item.name: table.disabled_touch[index] for index, item in enumerate(table.space.classes)}
    assert disabled["healthy"] == ()
    assert disabled["jammed_joint@0"] == ()
    assert disabled["missing_toe@1+jammed_joint@3"] == (1,)
    assert disabled["missing_toe@2+missing_toe@5"] == (2, 5)


def test_touch_addresses_and_limb_bodies_follow_the_ring(tables: dict[str, ClassTable]) -> None:
    table = tables["hexapod"]
    model = table.models[0]
    assert table.touch_addresses == (0, 1, 2, 3, 4, 5)
    assert table.limb_bodies == tuple(tuple(range(2 + 3 * limb, 5 + 3 * limb)) for limb in range(6))
    assert model.body(table.main_body).name == "torso"
    assert tables["ant"].touch_addresses == ()


def test_types_and_their_number_can_be_chosen() -> None:
    table = compile_class_table("hexapod", types=["missing_toe"], max_damaged_limbs=1)
    assert [item.name for item in table.space.classes][:2] == ["healthy", "missing_toe@0"]
    assert len(table.models) == 7


def test_damage_options_take_precedence_over_the_robot_toml() -> None:
    table = compile_class_table(
        "ant",
        types=["jammed_joint"],
        max_damaged_limbs=1,
        severity=0.5,
        damage_options={"jammed_joint": {"range_deg": 10}},
    )
    assert np.rad2deg(table.models[1].joint("hip_1").range) == pytest.approx([-20, 20])
    assert table.severity == 0.5


def test_physics_switches_the_integrator_and_nothing_else() -> None:
    default = compile_class_table("ant", max_damaged_limbs=0).models[0]
    euler = compile_class_table("ant", max_damaged_limbs=0, physics="euler").models[0]
    rk4 = compile_class_table("ant", max_damaged_limbs=0, physics="rk4").models[0]
    assert default.opt.integrator == rk4.opt.integrator == mujoco.mjtIntegrator.mjINT_RK4
    assert euler.opt.integrator == mujoco.mjtIntegrator.mjINT_EULER
    assert euler.opt.timestep == default.opt.timestep


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"severity": 0.0}, "severity"),
        ({"severity": 1.5}, "severity"),
        ({"severity": float("nan")}, "severity"),
        ({"types": ["rust"]}, "unknown damage type 'rust'"),
        ({"types": ["missing_toe", "missing_toe"]}, "must differ"),
        (
            {"types": ["missing_toe"], "damage_options": {"jammed_joint": {}}},
            "damage_options has jammed_joint",
        ),
        ({"damage_options": {"missing_toe": {"size": 1}}}, "unknown parameters size"),
        ({"physics": "rk5"}, "physics must be one of rk4, euler"),
    ],
)
def test_wrong_parameters_are_rejected(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        compile_class_table("ant", **arguments)  # type: ignore[arg-type]


def test_more_classes_than_memory_holds_are_rejected_before_they_are_compiled(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    size = compile_class_table("ant", max_damaged_limbs=0).models[0].nbuffer
    monkeypatch.setattr(class_table, "_MOST_MEMORY", 33 * size)
    assert len(compile_class_table("ant").models) == 33
    monkeypatch.setattr(class_table, "_MOST_MEMORY", 33 * size - 1)
    with pytest.raises(ConfigError, match=f"33 damage classes of {size} bytes each need"):
        compile_class_table("ant")


@dataclass(frozen=True)
class ExtraGeom(DamageType):
    """Damage that adds a part, which no class may do."""

    name: ClassVar[str] = "extra_geom"

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        spec.body(limb.body).add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.1 * severity, 0, 0])


@dataclass(frozen=True)
class NegativeSize(DamageType):
    """Damage that MuJoCo's compiler refuses."""

    name: ClassVar[str] = "negative_size"

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        spec.geom(limb.toe_geom).size = [-severity, 0, 0]


@dataclass(frozen=True)
class SlipperyToe(DamageType):
    """Damage that changes what contacts are mixed from."""

    friction: float = 0.5

    name: ClassVar[str] = "slippery_toe"

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        spec.geom(limb.toe_geom).friction[0] *= 1 - severity * self.friction
        spec.geom("floor").friction[0] = 0


@pytest.fixture
def own_types(monkeypatch: pytest.MonkeyPatch) -> None:
    for kind in (ExtraGeom, NegativeSize, SlipperyToe):
        monkeypatch.setitem(DAMAGE_TYPES, kind.name, kind)


@pytest.mark.usefixtures("own_types")
def test_a_class_of_other_sizes_is_rejected_by_name_and_size() -> None:
    with pytest.raises(ClassTableError, match=r"extra_geom@0.*ngeom is 15 instead of 14"):
        compile_class_table("ant", types=["extra_geom"])


@pytest.mark.usefixtures("own_types")
def test_a_class_that_does_not_compile_is_rejected_with_mujocos_message() -> None:
    with pytest.raises(ClassTableError, match=r"negative_size@0 does not compile: .*size"):
        compile_class_table("ant", types=["negative_size"])


@pytest.mark.usefixtures("own_types")
def test_damage_to_contact_parameters_reaches_the_explicit_contacts() -> None:
    table = compile_class_table("ant", types=["slippery_toe"], max_damaged_limbs=1)
    frictions = table.models[1].pair_friction[:, 0]
    assert sorted(frictions.tolist()) == [0.5] + [1.0] * 12


def edited_ant(folder: Path, toml: tuple[str, str] = ("", ""), mjcf: tuple[str, str] = ("", "")) -> Robot:
    robot = load_robot("ant")
    (folder / "ant.xml").write_text(robot.mjcf_path.read_text().replace(*mjcf, 1))
    (folder / "ant.toml").write_text(robot.toml_text.replace(*toml, 1))
    return load_robot(folder / "ant.toml")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"hip_1"', '"hip_9"', "limb front_left: the MJCF has no joint 'hip_9'"),
        ('["hip_1"', '["root"', "limb front_left: root is not part of body front_left_limb"),
        ('body = "back_left_limb"', 'body = "front_left_upper"', "belongs to limb front_left already"),
        ('body = "back_left_limb"', 'body = "tail"', "no body 'tail'"),
        ('main_body = "torso"', 'main_body = "trunk"', "main_body: the MJCF has no body 'trunk'"),
    ],
)
def test_a_robot_toml_that_does_not_fit_its_mjcf_is_rejected(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    robot = edited_ant(tmp_path, toml=(old, new))
    with pytest.raises(ConfigError, match=message):
        compile_class_table(robot, max_damaged_limbs=0)


def test_an_mjcf_that_mujoco_cannot_read_is_rejected_with_its_message(tmp_path: Path) -> None:
    robot = edited_ant(tmp_path, mjcf=("<option ", "<optoin "))
    with pytest.raises(ConfigError, match=r"cannot read .*ant\.xml"):
        compile_class_table(robot)
