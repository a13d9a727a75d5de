"""Several damages on a limb: classes, codes, and the models that their edits make."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import mujoco
import numpy as np
import pytest

import dappo_batch as db
from dappo_batch.damage import DAMAGE_TYPES, make_damage_type
from dappo_batch.model import robot_spec
from dappo_batch.model.floor_pairs import make_floor_contacts_explicit

from .command_line import dappo_batch

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

TYPES = ("jammed_joint", "missing_toe", "weak_motor")


def by_hand(robot: db.Robot, types: Sequence[str], limb: int) -> mujoco.MjModel:
    """Compile a robot with damages of a limb, applied one after the other."""
    spec, _ = robot_spec.read_robot_spec(robot)
    for name in types:
        make_damage_type(name, robot.damage_options(name)).apply(spec, robot.limbs[limb], 1.0)
    make_floor_contacts_explicit(spec)
    return spec.compile()


def arrays(model: mujoco.MjModel) -> dict[str, Any]:
    found = {name: getattr(model, name) for name in dir(model) if not name.startswith("_")}
    return {name: value for name, value in found.items() if isinstance(value, np.ndarray)}


def test_classes_are_sets_of_types_and_their_models_those_of_the_edits_in_order() -> None:
    robot = db.load_robot("ant")
    table = db.compile_class_table(robot, types=TYPES, max_damaged_limbs=1, max_damages_per_limb=2)
    space = table.space
    assert space.max_damages_per_limb == 2
    assert len(space) == 1 + 4 * (3 + 3)
    pairs = [
        f"{one}@{limb}+{two}@{limb}" for limb in range(4) for one, two in itertools.combinations(TYPES, 2)
    ]
    assert [item.name for item in space.classes[13:]] == pairs
    item = space.classes[space.parse("weak_motor@2+jammed_joint@2")]
    assert item.name == "jammed_joint@2+weak_motor@2"
    assert item.group == "D1_3 L"
    assert item.damages == [(2, "jammed_joint"), (2, "weak_motor")]
    assert np.flatnonzero(item.code).tolist() == [6, 8]
    for name in ("jammed_joint@2+weak_motor@2", "missing_toe@1+weak_motor@1"):
        got = arrays(table.models[space.parse(name)])
        parts = [part.split("@") for part in name.split("+")]
        for field, value in arrays(by_hand(robot, [kind for kind, _ in parts], int(parts[0][1]))).items():
            np.testing.assert_array_equal(got[field], value, err_msg=field)
    assert table.disabled_touch[space.parse("missing_toe@1+weak_motor@1")] == (1,)
    with pytest.raises(
        db.ConfigError, match=r"3 damages of limb 0; a limb has at most 2, see max_damages_per_limb"
    ):
        space.parse("jammed_joint@0+missing_toe@0+weak_motor@0")


@pytest.mark.parametrize("name", ["ant", "go1"])
def test_types_combine_on_a_limb_in_any_order_unless_two_remove_parts(name: str) -> None:
    robot = db.load_robot(name)
    options: dict[str, Any] = {"max_damaged_limbs": 1, "max_damages_per_limb": 2}
    for missing in ("missing_shank", "missing_limb"):
        types = ["jammed_joint", missing, "weak_motor", "dead_motor"]
        for order in (types, types[::-1]):
            table = db.compile_class_table(robot, types=order, **options)
            assert len(table.models) == 1 + 4 * (4 + 6)
            for model in table.models:
                data = mujoco.MjData(model)
                if model.nkey:
                    mujoco.mj_resetDataKeyframe(model, data, 0)
                mujoco.mj_step(model, data, nstep=50)
                assert not data.warning[mujoco.mjtWarning.mjWARN_BADQACC].number
                assert np.isfinite(data.qpos).all()
    with pytest.raises(db.ConfigError, match="missing_shank, missing_limb all remove parts of a limb"):
        db.compile_class_table(robot, types=["missing_shank", "dead_motor", "missing_limb"], **options)
    assert (
        len(
            db.compile_class_table(robot, types=["missing_shank", "missing_limb"], max_damaged_limbs=1).models
        )
        == 9
    )


@dataclass(frozen=True)
class OnlyWhole(db.DamageType):
    """A type that another one on the same limb makes impossible."""

    name: ClassVar[str] = "only_whole"

    def apply(self, spec: mujoco.MjSpec, limb: db.Limb, severity: float) -> None:
        del severity
        joint = spec.joint(limb.joints[0])
        if joint.range[1] - joint.range[0] < 1.0:
            raise db.ConfigError(f"only_whole: the joint {joint.name} moves too little")


def test_a_type_that_another_one_makes_impossible_is_refused_with_the_class() -> None:
    db.register_damage_type(OnlyWhole)
    try:
        with pytest.raises(
            db.ClassTableError,
            match=r"damage class jammed_joint@0.only_whole@0: only_whole: the joint hip_1 moves",
        ):
            db.compile_class_table(
                "ant", types=["jammed_joint", "only_whole"], max_damaged_limbs=1, max_damages_per_limb=2
            )
    finally:
        del DAMAGE_TYPES["only_whole"]


def test_both_backends_simulate_several_damages_alike() -> None:
    table = db.compile_class_table("ant", types=TYPES, max_damaged_limbs=1, max_damages_per_limb=3)
    options: dict[str, Any] = {"seed": 2, "damage": list(range(13, len(table.space))), "precision": "f64"}
    envs = {name: db.make_vec(table, 32, backend=name, **options) for name in ("lanes", "mujoco")}
    rows = [env.reset()[0] for env in envs.values()]
    np.testing.assert_allclose(*rows, rtol=1e-6, atol=1e-7)
    rng = np.random.default_rng(0)
    for _ in range(5):
        action = rng.uniform(-1, 1, (32, 8)).astype(np.float32)
        for env in envs.values():
            env.step(action)
        for one, other in zip(*(env.get_state() for env in envs.values()), strict=True):
            error = np.sort(np.abs(one - other).max(axis=1))
            # The solver may stop an iteration earlier in one of the envs, with the accuracy of its tolerance.
            assert error[-2] < 1e-10
            assert error[-1] < 1e-4
    for env in envs.values():
        env.close()


def test_wrong_numbers_are_refused_with_what_is_possible() -> None:
    for most, error in (
        (0, "max_damages_per_limb"),
        (3, "max_damages_per_limb is 3, but there are 2 damage types, and a limb has each once"),
        (1.5, "max_damages_per_limb"),
    ):
        with pytest.raises(db.ConfigError, match=error):
            db.compile_class_table("ant", max_damages_per_limb=most)  # type: ignore[arg-type]
    table = db.compile_class_table("ant", max_damaged_limbs=1, max_damages_per_limb=2)
    assert len(table.space) == 1 + 4 * 3
    with pytest.raises(db.ConfigError, match="a compiled class table fixes"):
        db.make_vec(table, 1, max_damages_per_limb=2)
    envs = db.make_vec("ant", 1, max_damaged_limbs=1, max_damages_per_limb=2)
    assert len(envs.table.space) == 13
    envs.close()


def test_a_robot_toml_may_have_it_and_fewer_types_lower_it(tmp_path: Path) -> None:
    robot = db.load_robot("ant")
    text = robot.toml_text.replace("max_damaged_limbs = 2", "max_damaged_limbs = 1\nmax_damages_per_limb = 2")
    (tmp_path / "ant.toml").write_text(text)
    (tmp_path / "ant.xml").write_text(robot.mjcf_path.read_text())
    path = tmp_path / "ant.toml"
    assert len(db.compile_class_table(path).space) == 13
    assert len(db.compile_class_table(path, types=["jammed_joint"]).space) == 5
    output, _ = dappo_batch("classes", "--robot", path)
    assert "jammed_joint@0+missing_toe@0" in output
    output, _ = dappo_batch("classes", "--robot", path, "--max-damages-per-limb", "1")
    assert "jammed_joint@0+missing_toe@0" not in output
    output, _ = dappo_batch(
        "check", "ant", "--max-damages-per-limb", "2", "--max-damaged-limbs", "1", "--json"
    )
    assert "missing_toe@2+jammed_joint@2" not in output
    assert "jammed_joint@2+missing_toe@2" in output
    (tmp_path / "ant.toml").write_text(text.replace("max_damages_per_limb = 2", "max_damages_per_limb = 3"))
    with pytest.raises(
        db.ConfigError, match="`max_damages_per_limb` is 3, expected a whole number from 1 to 2"
    ):
        db.load_robot(path)


def test_a_policy_and_a_diagnoser_are_trained_with_several_damages_of_a_limb(tmp_path: Path) -> None:
    run = db.train(
        tmp_path / "run",
        robot="ant",
        num_envs=8,
        total_steps=128,
        set={
            "horizon": 16,
            "ppo.hidden": [8],
            "evaluation.episodes": 1,
            "env.max_episode_steps": 60,
            "damage.max_damaged_limbs": 1,
            "damage.max_damages_per_limb": 2,
        },
    )
    assert "jammed_joint@3+missing_toe@3" in (run.path / "eval" / "per_class.csv").read_text()
    pairs = tmp_path / "pairs"
    dappo_batch(
        *("diagnose", "collect", run.path, "--preset", "residual", "--timesteps", "5", "--rollouts", "6"),
        *("--onset", "2-4", "--delay", "2-4", "--out", pairs),
    )
    small = ("epochs=1", "embedding=8", "lstm=4", "hidden=[8]", "head=limbs")
    dappo_batch("diagnose", "train", pairs, "--out", tmp_path / "diagnoser", "--set", *small)
    diagnoser = db.Diagnoser.load(tmp_path / "diagnoser", expert=run.path)
    assert len(diagnoser.class_names) == 13
