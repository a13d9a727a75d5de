"""The lane engine compared with MuJoCo, state by state, with every damage class of both robots."""

from __future__ import annotations

import copy

import mujoco
import numpy as np
import pytest

from dappo_batch import ClassTable, ConfigError, compile_class_table
from dappo_batch._core import LaneWorlds

from .states import KINDS, States, advance, converged, evaluate, of_all_classes, relative_error

STATES_A_CLASS = 12
"""States of each kind for each of the 33 and 73 classes."""


@pytest.mark.parametrize("kind", KINDS)
def test_forces_equal_mujocos_up_to_rounding(table: ClassTable, kind: str) -> None:
    classes, states, expected = of_all_classes(table, kind, STATES_A_CLASS)
    touched = np.any(expected.cfrc_ext, axis=(1, 2))
    assert touched.mean() > 0.5 if kind in ("resting", "hard") else True
    assert not touched.any() if kind == "free" else True
    for precision, tolerance in (("f64", 1e-10), ("f32", 1e-4)):
        worlds = LaneWorlds(table, classes, precision=precision)
        qacc, cfrc_ext, touch = worlds.forward(*states)
        # At rest gravity and contacts cancel; single precision keeps digits of them, not of their sum.
        scale = expected.qacc_smooth if (precision, kind) == ("f32", "resting") else expected.qacc
        assert relative_error(qacc, expected.qacc, scale) < tolerance
        assert relative_error(cfrc_ext, expected.cfrc_ext) < tolerance
        assert relative_error(touch, expected.sensordata) < tolerance


def test_weak_motors_have_mujocos_forces(table: ClassTable) -> None:
    weak = compile_class_table(table.robot, types=["weak_motor"])
    classes, states, expected = of_all_classes(weak, "rollout", STATES_A_CLASS)
    qacc, _, _ = LaneWorlds(weak, classes, precision="f64").forward(*states)
    assert relative_error(qacc, expected.qacc) < 1e-10
    # The numbers depend on the damage: those of healthy motors differ.
    healthy, _, _ = LaneWorlds(weak, np.zeros_like(classes), precision="f64").forward(*states)
    assert relative_error(healthy[classes > 0], expected.qacc[classes > 0]) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("physics", [None, "rk4", "euler"])
def test_trajectories_follow_mujocos(table: ClassTable, physics: str | None) -> None:
    if physics is not None:
        table = compile_class_table(table.robot, physics=physics)  # type: ignore[arg-type]
    substeps = int(table.robot.spec["frame_skip"])
    classes, states, _ = of_all_classes(table, "rollout", 2)
    worlds = LaneWorlds(table, classes, precision="f64")
    models = [converged(model) for model in table.models]
    datas = [mujoco.MjData(models[number]) for number in classes]
    qpos, qvel = states.qpos, states.qvel
    for data, position, velocity in zip(datas, qpos, qvel, strict=True):
        data.qpos[:], data.qvel[:] = position, velocity
    rng = np.random.default_rng(1)
    low, high = table.models[0].actuator_ctrlrange.T
    for _ in range(20):
        ctrl = rng.uniform(low, high, states.ctrl.shape)
        qpos, qvel, _, _ = worlds.step(qpos, qvel, ctrl, substeps)
        for number, data, control in zip(classes, datas, ctrl, strict=True):
            data.ctrl[:] = control
            mujoco.mj_step(models[number], data, nstep=substeps)
    assert relative_error(qpos, np.array([data.qpos for data in datas])) < 1e-10
    assert relative_error(qvel, np.array([data.qvel for data in datas])) < 1e-10


def test_contact_forces_after_a_step_are_those_of_the_last_evaluation(table: ClassTable) -> None:
    """As Gymnasium reads them: MuJoCo's RK4 evaluates forces last in its fourth stage."""
    substeps = int(table.robot.spec["frame_skip"])
    classes, states, _ = of_all_classes(table, "resting", 2)
    worlds = LaneWorlds(table, classes, precision="f64")
    _, _, cfrc_ext, touch = worlds.step(*states, substeps)
    expected, sensors = [], []
    for number, qpos, qvel, ctrl in zip(classes, *states, strict=True):
        model = converged(table.models[number])
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, ctrl
        mujoco.mj_step(model, data, nstep=substeps)
        mujoco.mj_rnePostConstraint(model, data)
        expected.append(data.cfrc_ext.copy())
        sensors.append(data.sensordata.copy())
    assert np.any(expected)
    # Contacts are stiff: the rounding of the first substeps is amplified a thousandfold in the last one's
    # forces.
    assert relative_error(cfrc_ext, np.array(expected)) < 1e-8
    assert relative_error(touch, np.array(sensors)) < 1e-8


def _degenerate(model: mujoco.MjModel) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return states that no robot should be in, by name."""
    still = np.zeros(model.nv)
    upside_down = model.qpos0.copy()
    upside_down[3:7] = (0.0, 1.0, 0.0, 0.0)
    buried = model.qpos0.copy()
    buried[2] = -1.0
    straight_up = model.qpos0.copy()
    straight_up[2] *= 0.3
    straight_up[3:7] = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)
    spinning = still.copy()
    spinning[3:6] = (300.0, -200.0, 100.0)
    rushing = still.copy()
    rushing[:3], rushing[6:] = (500.0, -300.0, -200.0), 100.0
    unnormalised = model.qpos0.copy()
    unnormalised[3:7] = (0.2, 0.4, -0.1, 3.0)
    far = model.qpos0.copy()
    far[:2] = (1e6, -1e6)
    bent = model.qpos0.copy()
    bent[7:] = 40.0
    return {
        "upside down": (upside_down, still),
        "buried": (buried, still),
        "on its nose": (straight_up, still),
        "spinning": (model.qpos0, spinning),
        "rushing": (model.qpos0, rushing),
        "quaternion of length 3": (unnormalised, still),
        "far away": (far, still),
        "joints wound up": (bent, still),
    }


def test_degenerate_states_have_mujocos_forces(table: ClassTable) -> None:
    model = converged(table.models[0])
    for name, (qpos, qvel) in _degenerate(model).items():
        states = States(qpos[None], qvel[None], np.zeros((1, model.nu)))
        expected = evaluate(model, states)
        worlds = LaneWorlds(table, np.zeros(1, dtype=np.int64), precision="f64")
        qacc, cfrc_ext, _ = worlds.forward(*states)
        assert relative_error(qacc, expected.qacc) < 1e-9, name
        assert relative_error(cfrc_ext, expected.cfrc_ext) < 1e-9, name


def test_one_step_from_degenerate_states_is_mujocos(table: ClassTable) -> None:
    """Fast rotations reach the closed form of the rotation correction."""
    model = converged(table.models[0])
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for name, (qpos, qvel) in _degenerate(model).items():
        states = States(qpos[None], qvel[None], np.zeros((1, model.nu)))
        expected = advance(model, states, 1)
        worlds = LaneWorlds(table, np.zeros(1, dtype=np.int64), precision="f64")
        after, velocity, _, _ = worlds.step(*states, 1)
        assert relative_error(after, expected[0]) < 1e-9, name
        assert relative_error(velocity, expected[1]) < 1e-9, name


@pytest.mark.parametrize("simd", ["avx512", "avx2", "portable"])
def test_all_instruction_sets_are_bit_identical(ant_table: ClassTable, simd: str) -> None:
    classes, states, _ = of_all_classes(ant_table, "hard", 1)
    portable = LaneWorlds(ant_table, classes, precision="f64", simd="portable")
    try:
        other = LaneWorlds(ant_table, classes, precision="f64", simd=simd)
    except ConfigError as error:
        if f"simd is `{simd}`, but this processor has" not in str(error):
            raise
        pytest.skip(str(error))
    for got, expected in zip(other.forward(*states), portable.forward(*states), strict=True):
        assert np.array_equal(got, expected)


def test_a_nearly_massless_limb_is_simulated_as_mujoco_does(ant_table: ClassTable) -> None:
    models = []
    for model in ant_table.models:
        light = copy.copy(model)
        light.body_mass[-1] *= 1e-6
        light.body_inertia[-1] *= 1e-6
        mujoco.mj_setConst(light, mujoco.MjData(light))
        models.append(light)
    table = type(ant_table)(**{**ant_table.__dict__, "all_models": tuple(models)})
    classes, states, expected = of_all_classes(table, "hard", 2)
    qacc, cfrc_ext, _ = LaneWorlds(table, classes, precision="f64").forward(*states)
    assert relative_error(qacc, expected.qacc) < 1e-9
    assert relative_error(cfrc_ext, expected.cfrc_ext) < 1e-9
