"""The class table on the device compared with mujoco_warp's own copy of every compiled model."""

from __future__ import annotations

import copy
import dataclasses

import numpy as np
import pytest

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

import mujoco_warp as mjw

from dappo_batch import ClassTable
from dappo_batch.kernels.damage import DamageFields, class_rows, gather_rows

SHARED = {"dof_length", "site_size"}  # see `test_a_touch_zone_may_differ_only_where_the_sensor_is_disabled`


def disabled_sites(table: ClassTable) -> list[frozenset[int]]:
    """Return per class the touch sites that are not read; sites are in the order of limbs in both robots."""
    return [frozenset(limbs) for limbs in table.disabled_touch]


def test_every_world_has_the_model_that_mujoco_compiled_for_its_class(table: ClassTable) -> None:
    count = len(table.models)
    model = mjw.put_model(table.models[0])
    rows = class_rows(model, table.models, disabled_sites(table))
    fields = DamageFields(model, rows, count)
    classes = np.random.default_rng(0).permutation(count)
    fields.gather(wp.full(count, True, dtype=wp.bool), wp.array(classes, dtype=wp.int32))
    assert {"jnt_range", "geom_size", "geom_rbound", "body_mass", "dof_invweight0", "actuator_acc0"} <= set(
        rows.columns
    )
    # mujoco_warp's fields are compared, not MuJoCo's, so that those that it derives are included.
    names = [field.name for field in dataclasses.fields(mjw.Model) if field.name not in SHARED]
    arrays = {name: getattr(model, name) for name in names if isinstance(getattr(model, name), wp.array)}
    values = {name: array.numpy() for name, array in arrays.items()}
    for world, number in enumerate(classes):
        expected = mjw.put_model(table.models[number])
        for name, value in values.items():
            got = value[world : world + 1] if name in rows.columns else value
            reference = getattr(expected, name).numpy()
            np.testing.assert_array_equal(got, reference, err_msg=f"{name}, class {number}")


def test_worlds_outside_the_mask_keep_their_model() -> None:
    rng = np.random.default_rng(1)
    rows = rng.integers(-(2**31), 2**31, (5, 7)).astype(np.int32)
    before = rng.integers(-(2**31), 2**31, (9, 7)).astype(np.int32)
    mask, classes = rng.random(9) < 0.5, rng.integers(0, 5, 9)
    after = wp.array(before, dtype=wp.int32)
    inputs = [wp.array(rows), wp.array(mask, dtype=wp.bool), wp.array(classes, dtype=wp.int32)]
    wp.launch(gather_rows, (9, 7), inputs=inputs, outputs=[after])
    np.testing.assert_array_equal(after.numpy(), np.where(mask[:, None], rows[classes], before))


def test_a_touch_zone_may_differ_only_where_the_sensor_is_disabled(hexapod_table: ClassTable) -> None:
    model = mjw.put_model(hexapod_table.models[0])
    with pytest.raises(ValueError, match="damage class 2 changes site_size"):
        class_rows(model, hexapod_table.models, [frozenset()] * len(hexapod_table.models))


def test_classes_that_differ_in_shared_fields_are_rejected(ant_table: ClassTable) -> None:
    model = mjw.put_model(ant_table.models[0])
    disabled = [frozenset()] * 2
    other = copy.copy(ant_table.models[0])
    other.jnt_limited[1] = 0
    with pytest.raises(ValueError, match="damage class 1 changes jnt_limited"):
        class_rows(model, [ant_table.models[0], other], disabled)
    other = copy.copy(ant_table.models[0])
    other.opt.timestep = 0.02
    with pytest.raises(ValueError, match=r"differ in opt\.timestep"):
        class_rows(model, [ant_table.models[0], other], disabled)
