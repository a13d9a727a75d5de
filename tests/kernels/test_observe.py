"""Observations of the kernels compared with NumPy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

from dappo_batch import ClassTable
from dappo_batch.kernels.observe import Observer
from dappo_batch.kernels.task import Task

from .physics import Physics

COUNT = 40


def reference(task: Task, classes: NDArray[np.int64], physics: Physics) -> NDArray[np.float32]:
    """Compute the observation of the robot TOML's terms in NumPy, [N, O]."""
    blocks = []
    for term in task.observation:
        name = term["term"]
        if name == "qpos":
            blocks.append(physics.qpos[:, term.get("skip", 0) :])
        elif name == "qvel":
            blocks.append(physics.qvel)
        elif name == "cfrc_ext":
            blocks.append(np.clip(physics.cfrc_ext, -term["clip"], term["clip"]).reshape(len(classes), -1))
        else:
            pressed = physics.sensordata[:, list(task.touch_addresses)] > 0.0
            blocks.append((pressed & ~task.disabled_touch[classes]).astype(np.float32))
    return np.concatenate([*blocks, task.codes[classes]], axis=1)


@pytest.mark.parametrize("observe_damage", [True, False])
def test_observations_equal_numpys(table: ClassTable, observe_damage: bool) -> None:
    rng = np.random.default_rng(0)
    task = Task.of(table)
    observer = Observer(task, observe_damage)
    physics = Physics.random(task, COUNT, rng)
    classes = rng.integers(0, len(table.models), COUNT)
    mask = rng.random(COUNT) < 0.7
    obs = wp.full((COUNT, observer.obs_dim), np.nan, dtype=wp.float32)
    observer.observe(physics.on_device(), wp.array(mask), wp.array(classes, dtype=wp.int32), obs)
    expected = reference(task, classes, physics)
    expected = expected if observe_damage else expected[:, : -task.codes.shape[1]]
    np.testing.assert_array_equal(obs.numpy()[mask], expected[mask])
    assert np.isnan(obs.numpy()[~mask]).all()
    assert observer.obs_dim == expected.shape[1]


def test_the_papers_input_lengths_are_119_and_65(ant_table: ClassTable, hexapod_table: ClassTable) -> None:
    lengths = [Observer(Task.of(table), True).obs_dim for table in (ant_table, hexapod_table)]
    assert lengths == [119, 65]


def test_terms_may_come_in_any_order_and_number(hexapod_table: ClassTable) -> None:
    rng = np.random.default_rng(1)
    terms = (
        {"term": "cfrc_ext", "clip": 0.5},
        {"term": "touch"},
        {"term": "qpos"},
        {"term": "cfrc_ext", "clip": 2.0},
    )
    task = dataclasses.replace(Task.of(hexapod_table), observation=terms)
    observer = Observer(task, True)
    physics = Physics.random(task, COUNT, rng)
    classes = rng.integers(0, len(task.models), COUNT)
    obs = wp.full((COUNT, observer.obs_dim), np.nan, dtype=wp.float32)
    everyone = wp.full(COUNT, True, dtype=wp.bool)
    observer.observe(physics.on_device(), everyone, wp.array(classes, dtype=wp.int32), obs)
    np.testing.assert_array_equal(obs.numpy(), reference(task, classes, physics))


def test_an_unknown_term_is_rejected_by_name(ant_table: ClassTable) -> None:
    task = dataclasses.replace(Task.of(ant_table), observation=({"term": "smell"},))
    with pytest.raises(ValueError, match="observation term 'smell'"):
        Observer(task, False)
