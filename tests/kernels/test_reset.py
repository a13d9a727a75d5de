"""Resets of the kernels compared with NumPy, and with the random streams in plain Python."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

import mujoco
import mujoco_warp as mjw

from dappo_batch import ClassTable
from dappo_batch.kernels.episode import Episodes
from dappo_batch.kernels.outcome import Outcome
from dappo_batch.kernels.reset import DRAW, EpisodeDraws, StateReset
from dappo_batch.kernels.task import Task

from .philox_numpy import Stream

INITIAL_STATE, DAMAGE_CLASS, ONSET = 0, 1, 2  # purposes of streams
COUNT = 50


def worlds_in_mid_episode(rng: np.random.Generator) -> tuple[Episodes, dict[str, NDArray[np.generic]]]:
    """Return episodes of arbitrary state, on the device and as arrays of NumPy."""
    episodes = Episodes.unstarted(rng.integers(0, 2**64, COUNT, dtype=np.uint64))
    numbers = rng.integers(0, 2**40, COUNT, dtype=np.uint64)
    numbers[:2] = 2**64 - 1  # before the first
    episodes.number.assign(numbers)
    running = (episodes.step, episodes.drawn_class, episodes.class_steps)
    for array in (*running, episodes.onset, episodes.damage_class):
        array.assign(rng.integers(100, 200, COUNT).astype(np.int32))
    return episodes, {name: array.numpy().copy() for name, array in vars(episodes).items()}


def cumulative(weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the cumulative normalised weights, summed in the order of Rust."""
    sums, total = [], 0.0
    for weight in weights:
        total += weight / weights.sum()
        sums.append(total)
    return np.array(sums)


@pytest.mark.parametrize("min_class_steps", [0, 300])
@pytest.mark.parametrize("onset_range", [(0, 0), (20, 150), (0, 1), (3, 3)])
def test_damage_classes_and_onsets_are_those_of_the_worlds_streams(
    onset_range: tuple[int, int], min_class_steps: int
) -> None:
    rng = np.random.default_rng(0)
    episodes, before = worlds_in_mid_episode(rng)
    weights = rng.random(33) * (rng.random(33) < 0.5)
    draws = EpisodeDraws(COUNT, 33)
    draws.cumulative.assign(cumulative(weights))
    draws.onset_range.assign(np.array(onset_range, dtype=np.int32))
    draws.min_class_steps.assign(np.array([min_class_steps], dtype=np.int32))
    mask = rng.random(COUNT) < 0.7
    mask[:2] = True
    draws.begin(episodes, wp.array(mask))

    expected = {name: array.copy() for name, array in before.items()}
    for world in np.flatnonzero(mask):
        key, number = int(before["key"][world]), (int(before["number"][world]) + 1) % 2**64
        u = Stream(key, number, DAMAGE_CLASS).uniform()
        drawn = int(np.searchsorted(cumulative(weights), u, side="right"))
        class_steps = before["step"][world] + before["class_steps"][world]
        kept = class_steps < min_class_steps
        expected["class_steps"][world] = class_steps if kept else 0
        if kept:
            drawn = before["drawn_class"][world]
        onset = onset_range[0] + Stream(key, number, ONSET).below(onset_range[1] - onset_range[0] + 1)
        expected["number"][world] = number
        expected["step"][world] = 0
        expected["drawn_class"][world] = drawn
        expected["onset"][world] = onset
        expected["damage_class"][world] = drawn if onset == 0 else 0
        assert kept or weights[drawn] > 0.0
    for name, array in vars(episodes).items():
        np.testing.assert_array_equal(array.numpy(), expected[name], err_msg=name)


def test_classes_and_onsets_may_be_fixed_for_some_worlds() -> None:
    rng = np.random.default_rng(1)
    (episodes, _), (free, _) = (worlds_in_mid_episode(np.random.default_rng(2)) for _ in range(2))
    draws = EpisodeDraws(COUNT, 73)
    draws.onset_range.assign(np.array([5, 9], dtype=np.int32))
    everyone = wp.full(COUNT, True, dtype=wp.bool)
    classes = np.where(rng.random(COUNT) < 0.5, rng.integers(0, 73, COUNT), DRAW).astype(np.int32)
    onsets = np.where(rng.random(COUNT) < 0.5, rng.integers(0, 3, COUNT), DRAW).astype(np.int32)
    draws.begin(episodes, everyone, wp.array(classes), wp.array(onsets))
    draws.begin(free, everyone)
    drawn = np.where(classes == DRAW, free.drawn_class.numpy(), classes)
    onset = np.where(onsets == DRAW, free.onset.numpy(), onsets)
    np.testing.assert_array_equal(episodes.drawn_class.numpy(), drawn)
    np.testing.assert_array_equal(episodes.onset.numpy(), onset)
    np.testing.assert_array_equal(episodes.damage_class.numpy(), np.where(onset == 0, drawn, 0))


def test_cumulative_weights_rounded_below_1_still_give_a_class_of_positive_weight() -> None:
    """As in Rust: the draw lies above all sums, and the classes at the end have weight 0."""
    episodes = Episodes.unstarted(np.arange(COUNT, dtype=np.uint64))
    draws = EpisodeDraws(COUNT, 4)
    draws.cumulative.assign(np.array([0.0, 1e-9, 1e-9, 1e-9]))
    draws.begin(episodes, wp.full(COUNT, True, dtype=wp.bool))
    assert (episodes.drawn_class.numpy() == 1).all()


def test_initial_states_are_reference_pose_plus_noise_of_the_worlds_streams(table: ClassTable) -> None:
    rng = np.random.default_rng(3)
    task = Task.of(table)
    healthy = table.models[0]
    model, data = mjw.put_model(healthy), mjw.make_data(healthy, nworld=COUNT)
    for array in (data.qpos, data.qvel, data.ctrl, data.qacc_warmstart, data.cfrc_ext, data.time):
        array.fill_(np.nan)
    episodes, _ = worlds_in_mid_episode(rng)
    episodes.damage_class.assign(rng.integers(0, len(table.models), COUNT).astype(np.int32))
    outcome = Outcome.zeros(COUNT)
    outcome.x.fill_(np.nan)
    mask = rng.random(COUNT) < 0.7
    StateReset(task, needs_forces=False).to_initial(model, data, wp.array(mask), episodes, outcome)

    keys, numbers = episodes.key.numpy(), episodes.number.numpy()
    for world in np.flatnonzero(mask):
        stream = Stream(int(keys[world]), int(numbers[world]), INITIAL_STATE)
        noise = task.qpos_noise * (2.0 * stream.uniforms(healthy.nq) - 1.0)
        np.testing.assert_allclose(data.qpos.numpy()[world], healthy.qpos0 + noise, rtol=0, atol=1e-7)
        velocity = task.qvel_noise * stream.normals(healthy.nv)
        np.testing.assert_allclose(data.qvel.numpy()[world], velocity, rtol=0, atol=1e-7)
    for array in (data.ctrl, data.qacc_warmstart, data.cfrc_ext, data.time):
        assert (array.numpy()[mask] == 0.0).all()
    np.testing.assert_allclose(outcome.x.numpy()[mask], data.qpos.numpy()[mask, 0], rtol=0, atol=1e-7)
    for array in (data.qpos, data.qvel, data.ctrl, data.qacc_warmstart, data.cfrc_ext, data.time, outcome.x):
        assert np.isnan(array.numpy()[~mask]).all()


def test_worlds_at_rest_have_the_sensor_readings_of_their_class_in_its_reference_pose(
    hexapod_table: ClassTable,
) -> None:
    count = len(hexapod_table.models)
    healthy = hexapod_table.models[0]
    model, data = mjw.put_model(healthy), mjw.make_data(healthy, nworld=count)
    for array in (data.qpos, data.qvel, data.sensordata):
        array.fill_(np.nan)
    classes = np.random.default_rng(4).permutation(count)
    reset = StateReset(Task.of(hexapod_table), needs_forces=True)
    reset.to_reference(model, data, wp.full(count, True, dtype=wp.bool), wp.array(classes, dtype=wp.int32))
    for world, number in enumerate(classes):
        reference = mujoco.MjData(hexapod_table.models[number])
        mujoco.mj_forward(hexapod_table.models[number], reference)
        np.testing.assert_allclose(data.sensordata.numpy()[world], reference.sensordata, rtol=1e-6)
        np.testing.assert_array_equal(data.qpos.numpy()[world], healthy.qpos0.astype(np.float32))
    assert (data.qvel.numpy() == 0.0).all()
