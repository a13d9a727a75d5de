"""The rollout engine and the stepper: their results, snapshots and restored states."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

import dappo_batch
from dappo_batch import ClassTable
from dappo_batch.kernels.engine import Engine
from dappo_batch.kernels.stepper import Stepper
from dappo_batch.kernels.task import Task

from .philox_numpy import Stream
from .test_policy import weights

COUNT, HORIZON, LIMIT = 4, 6, 4
HIDDEN = (7, 5)
KEYS = np.arange(COUNT, dtype=np.uint64) + 70
ACTION_NOISE = 3  # purpose of the stream


@pytest.fixture(scope="module")
def task() -> Task:
    """Compile the Ant with the integrator that takes the fewest launches."""
    return Task.of(dappo_batch.compile_class_table("ant", physics="euler"))


def new_engine(task: Task) -> Engine:
    """Return an engine with a fixed policy."""
    engine = Engine(
        task,
        KEYS,
        horizon=HORIZON,
        hidden=HIDDEN,
        cumulative=np.arange(1, 34) / 33,
        onset=(0, 2),
        min_class_steps=9,
        observe_damage=True,
        max_episode_steps=LIMIT,
        device=str(wp.get_device()),
    )
    rng = np.random.default_rng(0)
    actor, critic = (weights((119, *HIDDEN, outputs), rng) for outputs in (8, 1))
    engine.assign(actor, critic, np.full(8, -0.5, dtype=np.float32))
    engine.assign_transform((np.zeros(111, np.float32), np.ones(111, np.float32)), 4.0)
    return engine


def copies(arrays: dict[str, NDArray[np.generic]]) -> dict[str, NDArray[np.generic]]:
    """Return arrays that the next rollout does not overwrite."""
    return {name: array.copy() for name, array in arrays.items()}


def test_a_restored_engine_is_bit_identical_to_an_uninterrupted_one(task: Task) -> None:
    unbroken = new_engine(task)
    unbroken.collect(0)
    saved = [part.copy() for part in unbroken.snapshot()]
    expected = copies(unbroken.collect(HORIZON))
    resumed = new_engine(task)
    resumed.collect(999)  # somewhere else
    resumed.restore(*saved)
    got = resumed.collect(HORIZON)
    for name, array in expected.items():
        np.testing.assert_array_equal(got[name], array, err_msg=name)
    assert expected["truncated"].any()
    for part, other in zip(resumed.snapshot(), unbroken.snapshot(), strict=True):
        np.testing.assert_array_equal(part, other)


def test_the_first_actions_are_means_plus_the_noise_of_the_envs_streams(task: Task) -> None:
    rollout = new_engine(task).collect(5)
    noise = np.array([Stream(int(key), 5, ACTION_NOISE).normals(8) for key in KEYS])
    expected = rollout["means"][0] + np.exp(-0.5) * noise
    np.testing.assert_allclose(rollout["actions"][0], expected, rtol=0, atol=1e-6)


def stepper(table: ClassTable) -> Stepper:
    """Return worlds at the start of the first episodes of `KEYS`, each with a different class."""
    found = Stepper(Task.of(table), COUNT, device=str(wp.get_device()))
    everyone = np.arange(COUNT)
    found.reset(everyone, everyone, KEYS, np.zeros(COUNT, dtype=np.uint64))
    return found


def test_skipped_worlds_keep_their_state_and_do_not_change_the_others(ant_table: ClassTable) -> None:
    free, held = stepper(ant_table), stepper(ant_table)
    rng = np.random.default_rng(1)
    skip = np.array([False, True, False, True])
    no_world = np.zeros(COUNT, dtype=np.bool_)
    first, second = rng.uniform(-1, 1, (2, COUNT, 8)).astype(np.float32)
    for worlds in (free, held):
        worlds.step(first, no_world)
    before = [part.copy() for part in held.state()]
    expected, got = free.step(second, no_world), held.step(second, skip)
    for one, other in zip(expected, got, strict=True):
        np.testing.assert_array_equal(one[~skip], other[~skip])
    for one, other in zip(before, held.state(), strict=True):
        np.testing.assert_array_equal(one[skip], other[skip])
    # Skipped worlds continue from their state, as if the step had not happened.
    again = held.step(second, ~skip)
    for one, other in zip(expected, again, strict=True):
        np.testing.assert_array_equal(one[skip], other[skip])


def test_a_restored_stepper_is_bit_identical_to_an_uninterrupted_one(ant_table: ClassTable) -> None:
    rng = np.random.default_rng(2)
    actions = rng.uniform(-1, 1, (4, COUNT, 8)).astype(np.float32)
    no_world = np.zeros(COUNT, dtype=np.bool_)
    worlds = stepper(ant_table)
    for row in actions[:2]:
        worlds.step(row, no_world)
    worlds.set_classes(np.array([2]), np.array([9]))
    saved = worlds.snapshot().copy()
    expected = [[part.copy() for part in worlds.step(row, no_world)] for row in actions[2:]]
    other = stepper(ant_table)
    other.restore(saved, np.array([0, 1, 9, 3]))
    for row, step in zip(actions[2:], expected, strict=True):
        for one, part in zip(other.step(row, no_world), step, strict=True):
            np.testing.assert_array_equal(one, part)
