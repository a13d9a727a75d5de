"""Whole worlds: resets, divergence, overflow and onset must not change other worlds."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

import mujoco_warp as mjw

import dappo_batch
from dappo_batch import ClassTable
from dappo_batch.kernels.overflow import PhysicsOverflowError, check_overflow
from dappo_batch.kernels.task import Task
from dappo_batch.kernels.worlds import Worlds

COUNT = 6
KEYS = np.arange(COUNT, dtype=np.uint64) + 40


@pytest.fixture(scope="module")
def euler_table() -> ClassTable:
    """Compile the Ant with the integrator that takes the fewest launches."""
    return dappo_batch.compile_class_table("ant", physics="euler")


def actions(step: int, width: int) -> wp.array2d[wp.float32]:
    """Return random actions of a step, [N, A]."""
    rng = np.random.default_rng(step)
    return wp.array(rng.uniform(-1.2, 1.2, (COUNT, width)).astype(np.float32))


def run(worlds: Worlds, steps: int) -> NDArray[np.float32]:
    """Step, and return the observations [T, N, O]."""
    rows = []
    for step in range(steps):
        worlds.step(actions(step, worlds.action_dim))
        rows.append(worlds.obs.numpy().copy())
    return np.array(rows)


@pytest.mark.parametrize("robot", ["euler_table", "hexapod_table"])
def test_resets_of_other_worlds_do_not_change_a_world(robot: str, request: pytest.FixtureRequest) -> None:
    task = Task.of(request.getfixturevalue(robot))
    undisturbed, disturbed = Worlds(task, KEYS), Worlds(task, KEYS)
    for worlds in (undisturbed, disturbed):
        worlds.reset()
    expected = run(undisturbed, 6)
    mask = np.array([True, False, True, False, False, True])
    got = run(disturbed, 3)
    disturbed.reset(mask=mask)
    rows = []
    for step in range(3, 6):
        disturbed.step(actions(step, disturbed.action_dim))
        rows.append(disturbed.obs.numpy().copy())
    got = np.concatenate([got, rows])
    np.testing.assert_array_equal(got[:3], expected[:3])
    np.testing.assert_array_equal(got[3:, ~mask], expected[3:, ~mask])
    assert (got[3:, mask] != expected[3:, mask]).any(axis=(0, 2)).all()
    assert disturbed.episodes.number.numpy().tolist() == mask.astype(int).tolist()
    assert disturbed.episodes.step.numpy().tolist() == np.where(mask, 3, 6).tolist()


def test_a_diverged_world_ends_at_rest_in_the_reference_pose_of_its_class_and_is_reset(
    hexapod_table: ClassTable,
) -> None:
    task = Task.of(hexapod_table)
    broken, intact = Worlds(task, KEYS), Worlds(task, KEYS)
    sane = []
    for worlds in (broken, intact):
        worlds.reset(classes=np.arange(COUNT))
        sane.append(run(worlds, 2))
    qvel = broken.data.qvel.numpy()
    qvel[2, 5], qvel[4, 0] = np.nan, 1e30
    broken.data.qvel.assign(qvel)
    got, expected = run(broken, 1), run(intact, 1)

    others = [0, 1, 3, 5]
    np.testing.assert_array_equal(got[0, others], expected[0, others])
    outcome, ends = broken.outcome, broken.episode_ends
    assert np.flatnonzero(outcome.diverged.numpy()).tolist() == [2, 4]
    assert outcome.terminated.numpy()[[2, 4]].all()
    assert (outcome.reward.numpy()[[2, 4]] == 0.0).all()
    assert (outcome.forward_velocity.numpy()[[2, 4]] == 0.0).all()
    assert broken.diverged.numpy()[0] == 2
    envs = dappo_batch.make_vec(hexapod_table, COUNT, backend="mujoco", seed=0, damage="healthy")
    envs.reset(options={"damage_class": list(range(COUNT))})
    model = hexapod_table.models[0]
    at_rest = envs.set_state(np.tile(model.qpos0, (COUNT, 1)), np.zeros((COUNT, model.nv)))
    envs.close()
    np.testing.assert_allclose(ends.final_obs.numpy()[[2, 4]], at_rest[[2, 4]], rtol=0, atol=1e-6)

    assert broken.episodes.number.numpy().tolist() == [0, 0, 1, 0, 1, 0]
    assert np.isfinite(run(broken, 3)).all()
    assert broken.diverged.numpy()[0] == 2


def test_damage_in_mid_episode_changes_the_model_and_then_the_code(euler_table: ClassTable) -> None:
    task = Task.of(euler_table)
    worlds = Worlds(task, KEYS)
    struck = euler_table.space.parse("missing_toe@1")
    worlds.reset(classes=struck, onsets=[0, 1, 2, 3, 99, 0])
    width = worlds.code_length
    shown = []
    for step in range(4):
        shown.append(worlds.obs.numpy()[:, -width:].copy())
        worlds.step(actions(step, worlds.action_dim))
        masses = worlds.model.body_mass.numpy()
        for world, onset in enumerate([0, 1, 2, 3, 99, 0]):
            number = struck if step >= onset else 0
            assert worlds.episode_ends.damage_class.numpy()[world] == number
            np.testing.assert_array_equal(masses[world], task.models[number].body_mass.astype(np.float32))
    for step, codes in enumerate(shown):
        for world, onset in enumerate([0, 1, 2, 3, 99, 0]):
            # The policy observes the damage one step after its onset, as the observation precedes it.
            number = struck if onset == 0 or step > onset else 0
            np.testing.assert_array_equal(codes[world], task.codes[number])


def lay_down(worlds: Worlds) -> None:
    """Step every world from a state with all feet in the floor."""
    worlds.reset()
    model = worlds.task.models[0]
    lying = np.tile(model.qpos0, (COUNT, 1))
    lying[:, 2] = 0.2
    worlds.set_state(lying, np.zeros((COUNT, model.nv)))
    worlds.step(actions(0, worlds.action_dim))


@pytest.mark.parametrize(
    ("size", "room", "cause"),
    [
        ("njmax", 9, r"constraints of a world \(NEFC; njmax = 9\)"),
        ("nconmax", 2, r"pairs of geoms .* \(BROADPHASE; nconmax = 2\)"),
    ],
)
def test_an_overflow_is_an_error_with_the_size_to_raise(
    euler_table: ClassTable, size: str, room: int, cause: str
) -> None:
    worlds = Worlds(Task.of(euler_table), KEYS, **{size: room})
    lay_down(worlds)
    with pytest.raises(PhysicsOverflowError, match=f"6 of 6 worlds .*{cause}") as caught:
        worlds.raise_on_overflow()
    assert caught.value.sizes == {size: room}
    worlds.raise_on_overflow()


def test_a_solver_that_reaches_its_iteration_limit_is_no_error(euler_table: ClassTable) -> None:
    models = tuple(copy.copy(model) for model in euler_table.models)
    for model in models:
        model.opt.iterations = model.opt.ls_iterations = 1
    worlds = Worlds(Task.of(replace(euler_table, all_models=models)), KEYS)
    lay_down(worlds)
    assert (worlds.data.overflow.numpy() & int(mjw.OverflowType.ITERATIONS)).all()
    worlds.raise_on_overflow()
    assert np.isfinite(worlds.obs.numpy()).all()
    assert not worlds.data.overflow.numpy().any()


@pytest.mark.parametrize(
    ("flag", "size"),
    [
        ("NEFC", "njmax"),
        ("NJMAX_NNZ", "njmax"),
        ("BROADPHASE", "nconmax"),
        ("NARROWPHASE", "nconmax"),
        ("CCD", "nconmax"),
        ("HFIELD", None),
        ("EPA_HORIZON", None),
        ("NVMAX", None),
    ],
)
def test_every_harmful_overflow_flag_has_its_limit_in_the_message(flag: str, size: str | None) -> None:
    iterations = mjw.OverflowType.ITERATIONS
    flags = np.array([0, mjw.OverflowType[flag] | iterations, iterations], dtype=np.int32)
    with pytest.raises(PhysicsOverflowError, match=rf"^1 of 3 worlds .*\({flag}; ") as caught:
        check_overflow(flags, njmax=40, nconmax=9)
    assert caught.value.sizes == ({} if size is None else {size: {"njmax": 40, "nconmax": 9}[size]})
    assert "ITERATIONS" not in str(caught.value)


def test_harmless_overflow_flags_are_no_error() -> None:
    flags = mjw.OverflowType
    check_overflow(
        np.array([flags.ITERATIONS, flags.LS_ITERATIONS, flags.CONTACT_MATCH | flags.TACTILE]), 40, 9
    )


def test_the_default_buffer_sizes_suffice_for_a_robot_deep_in_the_floor(table: ClassTable) -> None:
    worlds = Worlds(Task.of(table), KEYS)
    worlds.reset()
    model = table.models[0]
    buried = np.tile(model.qpos0, (COUNT, 1))
    buried[:, 2] = -1.0
    buried[:, 7:] = 3.0
    worlds.set_state(buried, np.zeros((COUNT, model.nv)))
    worlds.step(actions(0, worlds.action_dim))
    worlds.raise_on_overflow()


def test_actions_are_clipped_scaled_and_counted_where_they_are_not_finite(
    hexapod_table: ClassTable,
) -> None:
    worlds = Worlds(Task.of(hexapod_table), KEYS)
    worlds.reset()
    chosen = actions(0, worlds.action_dim).numpy()
    chosen[0, 0], chosen[3, 7], chosen[5, 2] = np.nan, np.inf, 1e30
    worlds.step(wp.array(chosen))
    assert worlds.nonfinite_actions.numpy()[0] == 2
    chosen[0, 0] = chosen[3, 7] = 0.0
    running = ~worlds.episode_ends.ended.numpy()
    assert running.all()
    np.testing.assert_allclose(worlds.data.ctrl.numpy(), 0.785 * np.clip(chosen, -1, 1), rtol=1e-6)
