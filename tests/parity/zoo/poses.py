"""States of robots that stand in a pose of their own: the first keyframe of their MJCF."""

from __future__ import annotations

from collections.abc import Callable

import mujoco
import numpy as np

from ..states import Array, States

__all__ = ["KINDS", "random_controls", "rolled_out"]

_AFFINE = mujoco.mjtBias.mjBIAS_AFFINE


def _ranges(model: mujoco.MjModel) -> tuple[Array, Array]:
    """Return the limits of the joints, without those of the free one; ±1 rad where a joint has none."""
    limited = model.jnt_limited[1:, np.newaxis] == 1
    low, high = np.where(limited, model.jnt_range[1:], [-1.0, 1.0]).T
    return low, high


def _standing(model: mujoco.MjModel) -> Array:
    """Return the first keyframe, or else the reference pose, with all joints within their limits."""
    qpos: Array = (model.key_qpos[0] if model.nkey else model.qpos0).copy()
    qpos[7:] = qpos[7:].clip(*_ranges(model))
    return qpos


def random_controls(model: mujoco.MjModel, rng: np.random.Generator) -> Array:
    """Return controls within their ranges."""
    low, high = model.actuator_ctrlrange.T
    return rng.uniform(low, high)


def _hold(model: mujoco.MjModel, data: mujoco.MjData, pose: Array) -> None:
    """Set the controls that hold a pose: the targets of servos, and the torques of motors."""
    joints = model.actuator_trnid[:, 0]
    target, qpos = (positions[model.jnt_qposadr[joints]] for positions in (pose, data.qpos))
    mass = model.body_subtreemass[0]
    torque = mass * (4.0 * (target - qpos) - 0.1 * data.qvel[model.jnt_dofadr[joints]])
    data.ctrl[:] = np.where(model.actuator_biastype == _AFFINE, target, torque)


def _any_pose(
    model: mujoco.MjModel, rng: np.random.Generator, height: tuple[float, float], beyond: float
) -> tuple[Array, Array, Array]:
    """Return any orientation, fast, with joints up to `beyond` of their range outside it."""
    low, high = _ranges(model)
    qpos = _standing(model)
    qpos[2] = rng.uniform(*height)
    quat = rng.normal(size=4)
    qpos[3:7] = quat / np.linalg.norm(quat)
    qpos[7:] = low + (high - low) * rng.uniform(-beyond, 1.0 + beyond, low.size)
    return qpos, 3.0 * rng.normal(size=model.nv), random_controls(model, rng)


def _free(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> States:
    """Return states in the air, without a contact or a joint limit."""
    return _stack([_any_pose(model, rng, (3.0, 4.0), -0.02) for _ in range(count)])


def _hard(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> States:
    """Return states deep in the floor and beyond the joint limits."""
    height = float(_standing(model)[2])
    return _stack([_any_pose(model, rng, (0.0, 0.5 * height), 0.1) for _ in range(count)])


def rolled_out(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> States:
    """Return states that random actions lead to."""
    rows = []
    for _ in range(count):
        data = _dropped(model, rng)
        for _ in range(int(rng.integers(3, 15))):
            data.ctrl[:] = random_controls(model, rng)
            mujoco.mj_step(model, data, nstep=5)
        rows.append(_state(data))
    return _stack(rows)


def _resting(model: mujoco.MjModel, count: int, rng: np.random.Generator) -> States:
    """Return states of a robot that holds its pose on the floor."""
    rows = []
    for _ in range(count):
        data, pose = _dropped(model, rng), _standing(model)
        for _ in range(300):
            _hold(model, data, pose)
            mujoco.mj_step(model, data)
        rows.append(_state(data))
    return _stack(rows)


def _dropped(model: mujoco.MjModel, rng: np.random.Generator) -> mujoco.MjData:
    """Return a robot about to land in its pose."""
    data = mujoco.MjData(model)
    data.qpos[:] = _standing(model)
    data.qpos[7:] += rng.uniform(-0.1, 0.1, model.nq - 7)
    return data


def _state(data: mujoco.MjData) -> tuple[Array, Array, Array]:
    return data.qpos.copy(), data.qvel.copy(), data.ctrl.copy()


def _stack(rows: list[tuple[Array, Array, Array]]) -> States:
    return States(*map(np.array, zip(*rows, strict=True)))


KINDS: dict[str, Callable[[mujoco.MjModel, int, np.random.Generator], States]] = {
    "free": _free,
    "rollout": rolled_out,
    "resting": _resting,
    "hard": _hard,
}
