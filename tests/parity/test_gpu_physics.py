"""The GPU engine compared with MuJoCo, state by state, with every damage class.

Software Vulkan (Debian: `mesa-vulkan-drivers libvulkan1`) is a device for these tests. They are skipped in a
build without the feature `gpu`, and where there is no device at all.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from dappo_batch import ClassTable, compile_class_table
from dappo_batch._core import LaneWorlds

from .states import KINDS, converged, of_all_classes, relative_error

pytestmark = pytest.mark.usefixtures("gpu")

STATES_A_CLASS = 4
"""States of each kind for each class."""


def worlds(table: ClassTable, classes: np.ndarray, precision: str = "f64") -> LaneWorlds:
    return LaneWorlds(table, classes, precision=precision, device="gpu")


@pytest.mark.parametrize("kind", KINDS)
def test_forces_equal_mujocos_up_to_rounding(table: ClassTable, kind: str) -> None:
    classes, states, expected = of_all_classes(table, kind, STATES_A_CLASS)
    for precision, tolerance in (("f64", 1e-10), ("f32", 1e-4)):
        qacc, cfrc_ext, touch = worlds(table, classes, precision).forward(*states)
        # At rest gravity and contacts cancel; single precision keeps digits of them, not of their sum.
        scale = expected.qacc_smooth if (precision, kind) == ("f32", "resting") else expected.qacc
        assert relative_error(qacc, expected.qacc, scale) < tolerance
        assert relative_error(cfrc_ext, expected.cfrc_ext) < tolerance
        assert relative_error(touch, expected.sensordata) < tolerance


@pytest.mark.slow
@pytest.mark.parametrize("robot", ["go1", "go2"])
@pytest.mark.parametrize("kind", ["rollout", "hard"])
def test_servos_with_dry_friction_have_mujocos_forces(robot: str, kind: str) -> None:
    table = compile_class_table(robot)
    classes, states, expected = of_all_classes(table, kind, 1)
    qacc, cfrc_ext, touch = worlds(table, classes).forward(*states)
    assert relative_error(qacc, expected.qacc) < 1e-10
    assert relative_error(cfrc_ext, expected.cfrc_ext) < 1e-10
    assert relative_error(touch, expected.sensordata) < 1e-10


@pytest.mark.slow
@pytest.mark.parametrize("physics", [None, "rk4", "euler"])
def test_env_steps_follow_mujocos(table: ClassTable, physics: str | None) -> None:
    if physics is not None:
        table = compile_class_table(table.robot, physics=physics)  # type: ignore[arg-type]
    substeps = int(table.robot.spec["frame_skip"])
    classes, states, _ = of_all_classes(table, "rollout", 2)
    got = worlds(table, classes)
    models = [converged(model) for model in table.models]
    datas = [mujoco.MjData(models[number]) for number in classes]
    qpos, qvel = states.qpos, states.qvel
    for data, position, velocity in zip(datas, qpos, qvel, strict=True):
        data.qpos[:], data.qvel[:] = position, velocity
    rng = np.random.default_rng(1)
    low, high = table.models[0].actuator_ctrlrange.T
    for _ in range(5):
        ctrl = rng.uniform(low, high, states.ctrl.shape)
        qpos, qvel, cfrc_ext, touch = got.step(qpos, qvel, ctrl, substeps)
        for number, data, control in zip(classes, datas, ctrl, strict=True):
            data.ctrl[:] = control
            mujoco.mj_step(models[number], data, nstep=substeps)
            mujoco.mj_rnePostConstraint(models[number], data)
    assert relative_error(qpos, np.array([data.qpos for data in datas])) < 1e-10
    assert relative_error(qvel, np.array([data.qvel for data in datas])) < 1e-10
    # Contacts are stiff: the rounding of the first substeps is amplified in the last one's forces.
    assert relative_error(cfrc_ext, np.array([data.cfrc_ext for data in datas])) < 1e-8
    assert relative_error(touch, np.array([data.sensordata for data in datas])) < 1e-8


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_results_are_the_same_bits_every_time_and_whatever_the_neighbours(
    ant_table: ClassTable, precision: str
) -> None:
    classes, states, _ = of_all_classes(ant_table, "hard", 2)
    expected = worlds(ant_table, classes, precision).step(*states, 5)
    again = worlds(ant_table, classes, precision).step(*states, 5)
    order = np.random.default_rng(3).permutation(classes.size)[:13]
    few = worlds(ant_table, classes[order], precision).step(*(array[order] for array in states), 5)
    for array, other, part in zip(expected, again, few, strict=True):
        assert np.array_equal(array, other)
        assert np.array_equal(array[order], part)
