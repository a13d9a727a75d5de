"""The kernels compared with the `mujoco` backend in the same states, term by term."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

import mujoco_warp as mjw

import dappo_batch
from dappo_batch import ClassTable
from dappo_batch.kernels.observe import Observer
from dappo_batch.kernels.outcome import Outcome, RewardTerms
from dappo_batch.kernels.task import Task
from dappo_batch.kernels.worlds import Worlds

from .states import KINDS, States

SEED = 11
TOLERANCE = 1e-5
STATES_A_CLASS = 3


def keys(count: int) -> NDArray[np.uint64]:
    """Return the random keys of a vector env with `SEED`."""
    return np.arange(SEED, SEED + count, dtype=np.uint64)


def test_first_observations_of_every_class_are_those_of_the_mujoco_backend(table: ClassTable) -> None:
    count = len(table.models)
    envs = dappo_batch.make_vec(table, count, backend="mujoco", seed=SEED)
    worlds = Worlds(Task.of(table), keys(count))
    for _ in range(2):  # the first and the second episode
        expected, _ = envs.reset(options={"damage_class": np.arange(count)})
        worlds.reset(classes=np.arange(count))
        np.testing.assert_allclose(worlds.obs.numpy(), expected, rtol=0, atol=TOLERANCE)
    envs.close()


@pytest.mark.parametrize("onset", [(0, 0), (0, 3)])
def test_drawn_classes_and_onsets_are_those_of_the_mujoco_backend(
    table: ClassTable, onset: tuple[int, int]
) -> None:
    count = 100
    weights = np.random.default_rng(0).random(len(table.models))
    weights[::3] = 0.0
    envs = dappo_batch.make_vec(
        table, count, backend="mujoco", seed=SEED, damage=weights, onset=onset, max_episode_steps=5
    )
    worlds = Worlds(Task.of(table), keys(count))
    sums, total = [], 0.0
    for weight in weights:  # added one by one, as Rust does
        total += weight / weights.sum()
        sums.append(total)
    worlds.draws.cumulative.assign(np.array(sums))
    worlds.draws.onset_range.assign(np.array(onset, dtype=np.int32))
    for _ in range(3):
        expected, infos = envs.reset()
        worlds.reset()
        np.testing.assert_array_equal(worlds.episodes.damage_class.numpy(), infos["damage_class"])
        np.testing.assert_array_equal(worlds.episodes.onset.numpy(), infos["damage_onset"])
        np.testing.assert_allclose(worlds.obs.numpy(), expected, rtol=0, atol=TOLERANCE)
    envs.close()


@pytest.mark.parametrize("kind", KINDS)
def test_outcomes_of_steps_equal_those_of_the_mujoco_backend(table: ClassTable, kind: str) -> None:
    """The kernels compute observations and outcomes from a step of libmujoco with every class."""
    rng = np.random.default_rng(0)
    parts = [KINDS[kind](model, STATES_A_CLASS, rng) for model in table.models]
    states = States(*map(np.concatenate, zip(*parts, strict=True)))
    classes = np.repeat(np.arange(len(table.models)), STATES_A_CLASS)
    actions = rng.uniform(-1.2, 1.2, states.ctrl.shape).astype(np.float32)
    data, x_before = _stepped(table, classes, states, actions)
    rewards = [name for name in table.robot.spec["reward"] if name != "default"]
    assert "paper" in rewards
    for name in rewards:
        envs = dappo_batch.make_vec(
            table, len(classes), backend="mujoco", seed=SEED, reward=name, autoreset="disabled"
        )
        envs.reset(options={"damage_class": classes})
        envs.set_state(states.qpos, states.qvel)
        expected = envs.step(actions)
        envs.close()
        _compare(Task.of(table, name), data, x_before, classes, expected)


def _stepped(
    table: ClassTable, classes: NDArray[np.int64], states: States, actions: NDArray[np.float32]
) -> tuple[mjw.Data, NDArray[np.float32]]:
    """Return the data of libmujoco after an env step, and the earlier positions of the main bodies [N]."""
    task = Task.of(table)
    fields = ("qpos", "qvel", "qacc", "ctrl", "cfrc_ext", "sensordata", "xpos")
    values: dict[str, list[NDArray[np.float64]]] = {name: [] for name in fields}
    x_before = []
    data = mujoco.MjData(table.models[0])
    for number, qpos, qvel, action in zip(classes, states.qpos, states.qvel, actions, strict=True):
        model = table.models[number]
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = qpos, qvel
        mujoco.mj_forward(model, data)
        x_before.append(data.xpos[task.main_body, 0])
        data.ctrl[:] = task.action_scale * np.clip(action, -1.0, 1.0)
        mujoco.mj_step(model, data, nstep=task.frame_skip)
        mujoco.mj_rnePostConstraint(model, data)
        for name, rows in values.items():
            rows.append(getattr(data, name).copy())
    device_data = mjw.make_data(table.models[0], nworld=len(classes), nconmax=1, njmax=1)
    for name, rows in values.items():
        getattr(device_data, name).assign(np.array(rows, dtype=np.float32))
    return device_data, np.array(x_before, dtype=np.float32)


def _compare(
    task: Task,
    data: mjw.Data,
    x_before: NDArray[np.float32],
    classes: NDArray[np.int64],
    expected: tuple[Any, ...],
) -> None:
    """Compare the outcomes of the kernels for `data` with those of a vector env."""
    obs, rewards, terminated, _, infos = expected
    outcome = Outcome.zeros(len(classes))
    outcome.x.assign(x_before)
    observer = Observer(task, observe_damage=True)
    observed = wp.full(obs.shape, np.nan, dtype=wp.float32)
    everyone = wp.full(len(classes), True, dtype=wp.bool)
    observer.observe(data, everyone, wp.array(classes, dtype=wp.int32), observed)
    RewardTerms(task).compute(data, outcome)
    np.testing.assert_allclose(observed.numpy(), obs, rtol=1e-6, atol=TOLERANCE)
    np.testing.assert_array_equal(outcome.terminated.numpy(), terminated)
    np.testing.assert_allclose(outcome.reward.numpy(), rewards, rtol=1e-6, atol=TOLERANCE)
    velocity = outcome.forward_velocity.numpy()
    np.testing.assert_allclose(velocity, infos["forward_velocity"], rtol=1e-6, atol=TOLERANCE)
    assert not outcome.diverged.numpy().any()
