"""Checks of correctness on every device: graphs equal single launches, and the physics equals MuJoCo's."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

import mujoco
import numpy as np
import warp as wp
from numpy.typing import NDArray

from dappo_batch._core import collect_rollout
from dappo_batch.kernels.task import Task
from dappo_batch.kernels.worlds import Worlds
from dappo_batch.model import ClassTable, compile_class_table

from .scale import Scale
from .setting import collector, device_arrays

__all__ = ["decisions", "graph", "physics"]

_TRAJECTORY = 5e-5  # largest relative difference after 100 substeps with elliptic cones
_DECISION = 1e-5
_SUBSTEPS = 100


def graph(scale: Scale) -> dict[str, Any]:
    """Collect the same rollout launch by launch and twice from the graph; compare all buffers.

    Returns
    -------
    dict
        ``bit_equal``, and ``differences``: the largest difference of every buffer that differs. On a GPU the
        order of atomic additions may change the last bits, so a difference is a finding and not a failure.
    """
    captured = collector(Task.of(compile_class_table("ant", physics="euler")), 8, 6, scale.hidden)
    worlds, rollout = captured.worlds, captured.rollout

    def begin() -> None:
        worlds.reset(keys=np.arange(8, dtype=np.uint64))
        rollout.row.zero_()
        rollout.step.zero_()

    begin()
    for _ in range(rollout.horizon):
        captured.step()
    captured.policy.evaluate(worlds.obs)
    wp.copy(rollout.last_values, captured.policy.values)
    expected = {name: array.numpy().copy() for name, array in device_arrays(rollout).items()}
    differences: dict[str, float] = {}
    for _ in range(2):
        begin()
        captured.collect(first_step=0)
        for name, array in device_arrays(rollout).items():
            gap = np.abs(array.numpy().astype(np.float64) - expected[name].astype(np.float64)).max()
            if gap > 0.0:
                differences[name] = max(float(gap), differences.get(name, 0.0))
    return {"ok": True, "bit_equal": not differences, "differences": differences}


def physics(scale: Scale) -> dict[str, Any]:
    """Compare trajectories of 100 substeps with those of MuJoCo, with elliptic cones.

    Returns
    -------
    dict
        By robot, the largest relative difference of positions; ``ok`` if all are small.
    """
    errors = {robot: _trajectory_error(_elliptic(robot)) for robot in scale.warp_robots}
    return {"ok": max(errors.values()) < _TRAJECTORY, "limit": _TRAJECTORY} | errors


def decisions(device: str) -> dict[str, Any]:
    """Compare episodes and actions at the start of a training with those of the CPU backend."""
    settings: dict[str, Any] = {"num_envs": 64, "physics": "euler", "set": {"horizon": 1, "ppo.hidden": [32]}}
    host = collect_rollout(device="cpu", **settings)
    got = collect_rollout(device=device, **settings)
    same_episodes = bool((host["start_episodes"] == got["start_episodes"]).all())
    names = ("obs", "actions", "means", "log_probs", "values")
    errors = {name: float(np.abs(got[name] - host[name]).max()) for name in names}
    ok = same_episodes and max(errors.values()) < _DECISION
    return {"ok": ok, "limit": _DECISION, "same_episodes": same_episodes} | errors


def _elliptic(robot: str) -> ClassTable:
    """Compile a robot with elliptic friction cones, which are the same in both engines."""
    table = compile_class_table(robot)
    for model in table.models:
        model.opt.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        model.opt.tolerance = 0.0
        model.opt.iterations = model.opt.ls_iterations = 100
    return table


def _trajectory_error(table: ClassTable) -> float:
    specs = ("healthy", "jammed_joint@0", "missing_toe@1", "jammed_joint@0+missing_toe@2")
    classes = [table.space.parse(spec) for spec in specs]
    task = dataclasses.replace(Task.of(table), height=(-math.inf, math.inf))
    rng = np.random.default_rng(3)
    model, noise = table.models[0], table.robot.spec["reset"]
    qpos = model.qpos0 + noise["qpos_noise"] * rng.uniform(-1, 1, (len(classes), model.nq))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    qvel = noise["qvel_noise"] * rng.normal(size=(len(classes), model.nv))
    qpos, qvel = (array.astype(np.float32).astype(np.float64) for array in (qpos, qvel))
    steps = _SUBSTEPS // task.frame_skip
    actions = rng.uniform(-1, 1, (steps, len(classes), model.nu)).astype(np.float32)
    ctrl = task.action_scale * actions.astype(np.float64)

    worlds = Worlds(task, np.arange(len(classes), dtype=np.uint64), max_episode_steps=10**6)
    worlds.model.opt.tolerance.fill_(1e-9)  # mujoco_warp stops at 1e-6 otherwise
    worlds.model.opt.ls_tolerance.fill_(1e-4)
    worlds.reset(classes=classes)
    worlds.set_state(qpos, qvel)
    for row in actions:
        worlds.step(wp.array(row))
    worlds.raise_on_overflow()
    expected = [
        _by_mujoco(table.models[number], qpos[env], qvel[env], ctrl[:, env], task)
        for env, number in enumerate(classes)
    ]
    gap = np.abs(worlds.data.qpos.numpy() - expected) / np.maximum(1.0, np.abs(expected))
    return float(gap.max())


def _by_mujoco(
    model: mujoco.MjModel,
    qpos: NDArray[np.float64],
    qvel: NDArray[np.float64],
    ctrl: NDArray[np.float64],
    task: Task,
) -> NDArray[np.float64]:
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos, qvel
    for row in ctrl:
        data.ctrl[:] = row
        mujoco.mj_step(model, data, nstep=task.frame_skip)
    positions: NDArray[np.float64] = data.qpos.copy()
    return positions
