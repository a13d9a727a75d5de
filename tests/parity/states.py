"""States in which two physics are compared, from usual to extreme."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from dappo_batch import ClassTable

Array = NDArray[np.float64]


class States(NamedTuple):
    """Positions [N, nq], velocities [N, nv] and controls [N, nu]."""

    qpos: Array
    qvel: Array
    ctrl: Array


class Reference(NamedTuple):
    """What MuJoCo computes: accelerations [N, nv], contact forces [N, nbody, 6] and sensors [N, ns]."""

    qacc: Array
    qacc_smooth: Array
    cfrc_ext: Array
    sensordata: Array


def converged(model: mujoco.MjModel) -> mujoco.MjModel:
    """Return a copy of the model whose solver is Newton's and iterates until convergence."""
    model = copy.copy(model)
    model.opt.solver = mujoco.mjtSolver.mjSOL_NEWTON
    model.opt.tolerance = 0.0
    model.opt.iterations = 100
    model.opt.ls_iterations = 100
    return model


def with_cone(table: ClassTable, cone: mujoco.mjtCone) -> ClassTable:
    """Return the same robots with this friction cone, and a solver that iterates until convergence."""
    models = tuple(converged(model) for model in table.models)
    for model in models:
        model.opt.cone = cone
    return dataclasses.replace(table, all_models=models)


def evaluate(model: mujoco.MjModel, states: States) -> Reference:
    """Evaluate the forces in every state with MuJoCo."""
    data = mujoco.MjData(model)
    results = []
    for qpos, qvel, ctrl in zip(*states, strict=True):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, ctrl
        mujoco.mj_forward(model, data)
        mujoco.mj_rnePostConstraint(model, data)
        results.append(
            [array.copy() for array in (data.qacc, data.qacc_smooth, data.cfrc_ext, data.sensordata)]
        )
    return Reference(*map(np.array, zip(*results, strict=True)))


def advance(model: mujoco.MjModel, states: States, substeps: int) -> tuple[Array, Array]:
    """Step every state with MuJoCo; return positions [N, nq] and velocities [N, nv]."""
    data = mujoco.MjData(model)
    results = []
    for qpos, qvel, ctrl in zip(*states, strict=True):
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = qpos, qvel, ctrl
        mujoco.mj_step(model, data, nstep=substeps)
        results.append((data.qpos.copy(), data.qvel.copy()))
    qpos, qvel = map(np.array, zip(*results, strict=True))
    return qpos, qvel


def _controls(model: mujoco.MjModel, rng: np.random.Generator) -> Array:
    low, high = model.actuator_ctrlrange.T
    controls: Array = rng.uniform(low, high)
    return controls


def _stack(rows: list[tuple[Array, Array, Array]]) -> States:
    return States(*map(np.array, zip(*rows, strict=True)))


def _tumbling(
    model: mujoco.MjModel, count: int, rng: np.random.Generator, height: tuple[float, float], beyond: float
) -> States:
    """Any orientation, fast, with joints up to `beyond` of their range outside it."""
    low, high = model.jnt_range[1:].T
    rows = []
    for _ in range(count):
        qpos = model.qpos0.copy()
        qpos[2] = rng.uniform(*height)
        quat = rng.normal(size=4)
        qpos[3:7] = quat / np.linalg.norm(quat)
        qpos[7:] = low + (high - low) * rng.uniform(-beyond, 1.0 + beyond, low.size)
        rows.append((qpos, 3.0 * rng.normal(size=model.nv), _controls(model, rng)))
    return _stack(rows)


def free(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> States:
    """Return states in the air, without a contact or a joint limit."""
    return _tumbling(model, count, rng, (3.0, 4.0), -0.02)


def hard(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> States:
    """Return states deep in the floor and beyond the joint limits."""
    size = float(model.qpos0[2])
    return _tumbling(model, count, rng, (0.0, 0.5 * size), 0.1)


def rollout(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> States:
    """Return states that random actions lead to."""
    data = mujoco.MjData(model)
    noise = 0.1 * float(model.qpos0[2])
    rows: list[tuple[Array, Array, Array]] = []
    while len(rows) < count:
        mujoco.mj_resetData(model, data)
        data.qpos[:] += rng.uniform(-noise, noise, model.nq)
        data.qvel[:] += noise * rng.normal(size=model.nv)
        for _ in range(4):
            for _ in range(int(rng.integers(3, 10))):
                data.ctrl[:] = _controls(model, rng)
                mujoco.mj_step(model, data, nstep=5)
            rows.append((data.qpos.copy(), data.qvel.copy(), data.ctrl.copy()))
    return _stack(rows[:count])


def resting(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> States:
    """Return states of a robot that has come to lie or stand on the floor."""
    data = mujoco.MjData(model)
    data.qpos[7:] += rng.uniform(-0.1, 0.1, model.nq - 7)
    mujoco.mj_step(model, data, nstep=200)
    rows = []
    for _ in range(count):
        mujoco.mj_step(model, data, nstep=10)
        rows.append((data.qpos.copy(), data.qvel.copy(), data.ctrl.copy()))
    return _stack(rows)


KINDS: dict[str, Callable[[mujoco.MjModel, int, np.random.Generator], States]] = {
    "free": free,
    "rollout": rollout,
    "resting": resting,
    "hard": hard,
}


def of_all_classes(table: ClassTable, kind: str, count: int) -> tuple[NDArray[np.int64], States, Reference]:
    """Return `count` states of every class with MuJoCo's results, the classes mixed in random order.

    The states are numbers of single precision, so that both precisions evaluate the very same ones.
    """
    rng = np.random.default_rng(0)
    parts = []
    for number, model in enumerate(table.models):
        states = States(*(array.astype(np.float32).astype(float) for array in KINDS[kind](model, count, rng)))
        parts.append((np.full(count, number), *states, *evaluate(converged(model), states)))
    classes, *arrays = map(np.concatenate, zip(*parts, strict=True))
    order = rng.permutation(classes.size)
    arrays = [array[order] for array in arrays]
    return classes[order], States(*arrays[:3]), Reference(*arrays[3:])


def relative_error(got: Array, expected: Array, scale: Array | None = None) -> float:
    """Return the largest error of a world, max|Δ| / (1 + max|scale|); `scale` is `expected` by default."""
    scale = expected if scale is None else scale
    got, expected, scale = (array.reshape(len(array), -1) for array in (got, expected, scale))
    if expected.shape[1] == 0:
        return 0.0
    return float((np.abs(got - expected).max(1) / (1.0 + np.abs(scale).max(1))).max())
