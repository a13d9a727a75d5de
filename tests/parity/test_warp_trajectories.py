"""mujoco_warp's physics compared with libmujoco's, with the fields of the class table.

mujoco_warp computes in single precision. It places the tangents of pyramidal friction cones elsewhere than
MuJoCo, so with them trajectories part at the first contact; with elliptic cones they stay together.
"""

from __future__ import annotations

import dataclasses
import math
from typing import NamedTuple

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

from dappo_batch import ClassTable
from dappo_batch.kernels.task import Task
from dappo_batch.kernels.worlds import Worlds

from .states import with_cone

Array = NDArray[np.float64]

SPECS = ("healthy", "jammed_joint@0", "missing_toe@1", "jammed_joint@0+missing_toe@2")
SUBSTEPS = 100


class Trajectories(NamedTuple):
    """Positions [T, N, nq] and velocities [T, N, nv] after each env step; what touched something [T, N]."""

    qpos: Array
    qvel: Array
    touched: NDArray[np.bool_]


def start(table: ClassTable, count: int, height: float) -> tuple[Array, Array]:
    """Return states around the reference pose, `height` metres above it, rounded to single precision."""
    rng = np.random.default_rng(3)
    model, noise = table.models[0], table.robot.spec["reset"]
    qpos = model.qpos0 + noise["qpos_noise"] * rng.uniform(-1, 1, (count, model.nq))
    qpos[:, 2] += height
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    qvel = noise["qvel_noise"] * rng.normal(size=(count, model.nv))
    return qpos.astype(np.float32).astype(float), qvel.astype(np.float32).astype(float)


def actions(table: ClassTable, count: int, steps: int) -> NDArray[np.float32]:
    """Return random actions [T, N, nu]."""
    shape = (steps, count, table.models[0].nu)
    return np.random.default_rng(4).uniform(-1, 1, shape).astype(np.float32)


def by_mujoco(
    table: ClassTable, classes: list[int], state: tuple[Array, Array], ctrl: NDArray[np.float32]
) -> Trajectories:
    """Step the state with libmujoco."""
    datas = [mujoco.MjData(table.models[number]) for number in classes]
    for data, qpos, qvel in zip(datas, *state, strict=True):
        data.qpos[:], data.qvel[:] = qpos, qvel
    scale, frame_skip = table.robot.spec["action_scale"], table.robot.spec["frame_skip"]
    qpos, qvel, touched = [], [], []
    for row in ctrl:
        contact = []
        for number, data, values in zip(classes, datas, row, strict=True):
            data.ctrl[:] = scale * values
            counts = []
            for _ in range(frame_skip):
                mujoco.mj_step(table.models[number], data)
                counts.append(data.ncon)
            contact.append(any(counts))
        qpos.append([data.qpos.copy() for data in datas])
        qvel.append([data.qvel.copy() for data in datas])
        touched.append(contact)
    return Trajectories(np.array(qpos), np.array(qvel), np.array(touched))


def by_warp(
    table: ClassTable, classes: list[int], state: tuple[Array, Array], ctrl: NDArray[np.float32]
) -> Trajectories:
    """Step the state with the captured step; no height ends an episode."""
    task = dataclasses.replace(Task.of(table), height=(-math.inf, math.inf))
    worlds = Worlds(task, np.arange(len(classes), dtype=np.uint64), max_episode_steps=10**6)
    worlds.model.opt.tolerance.fill_(1e-9)  # mujoco_warp stops at 1e-6 otherwise
    worlds.model.opt.ls_tolerance.fill_(1e-4)
    values = wp.array(ctrl[0])
    worlds.reset()
    worlds.step(values)
    with wp.ScopedCapture() as capture:
        worlds.step(values)
    worlds.reset(classes=classes)
    worlds.set_state(*state)
    qpos, qvel, touched = [], [], []
    for row in ctrl:
        values.assign(row)
        wp.capture_launch(capture.graph)
        qpos.append(worlds.data.qpos.numpy().copy())
        qvel.append(worlds.data.qvel.numpy().copy())
        touched.append(worlds.data.cfrc_ext.numpy().any(axis=(1, 2)))
    worlds.raise_on_overflow()
    assert worlds.diverged.numpy()[0] == 0
    return Trajectories(np.array(qpos), np.array(qvel), np.array(touched))


def both(
    table: ClassTable, specs: list[str | int], height: float, substeps: int
) -> tuple[Trajectories, Trajectories]:
    """Return the trajectories of libmujoco and the kernels from the same state with the same actions."""
    classes = [table.space.parse(spec) for spec in specs]
    state = start(table, len(classes), height)
    ctrl = actions(table, len(classes), substeps // table.robot.spec["frame_skip"])
    return by_mujoco(table, classes, state, ctrl), by_warp(table, classes, state, ctrl)


def error(got: Array, expected: Array) -> float:
    """Return the largest difference, relative to numbers above 1."""
    return float((np.abs(got - expected) / np.maximum(1.0, np.abs(expected))).max())


def test_trajectories_with_elliptic_cones_stay_together(table: ClassTable) -> None:
    table = with_cone(table, mujoco.mjtCone.mjCONE_ELLIPTIC)
    expected, got = both(table, list(SPECS), 0.0, SUBSTEPS)
    assert expected.touched.mean() > 0.3
    assert error(got.qpos, expected.qpos) < 2e-5


@pytest.mark.slow
def test_trajectories_of_every_class_stay_together(table: ClassTable) -> None:
    table = with_cone(table, mujoco.mjtCone.mjCONE_ELLIPTIC)
    expected, got = both(table, list(range(len(table.models))), 0.0, SUBSTEPS)
    errors = [error(got.qpos[:, world], expected.qpos[:, world]) for world in range(len(table.models))]
    assert np.median(errors) < 1e-5
    assert max(errors) < 5e-5


def test_trajectories_with_pyramidal_cones_agree_up_to_the_first_contact(table: ClassTable) -> None:
    table = with_cone(table, mujoco.mjtCone.mjCONE_PYRAMIDAL)
    expected, got = both(table, list(SPECS), 0.5, SUBSTEPS)
    free = ~np.logical_or.accumulate(expected.touched)
    assert free[:5].all()
    assert error(got.qpos[free], expected.qpos[free]) < 2e-6
    assert not got.touched[free].any()
