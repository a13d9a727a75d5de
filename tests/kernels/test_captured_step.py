"""Rollouts of the captured step: bit-identical to single launches, and compared with NumPy."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

import dappo_batch
from dappo_batch.kernels.captured_step import CapturedStep
from dappo_batch.kernels.policy import Policy
from dappo_batch.kernels.rollout import Rollout
from dappo_batch.kernels.task import Task
from dappo_batch.kernels.worlds import Worlds

from .test_policy import numpy_mlp, weights

COUNT, HORIZON, LIMIT = 4, 6, 4
HIDDEN = (7, 5)
KEYS = np.arange(COUNT, dtype=np.uint64) + 2**63
BUFFERS = (
    *("obs", "actions", "means", "log_probs", "values", "rewards", "forward_velocity", "terminated"),
    *("truncated", "diverged", "damage_class", "final_values", "last_values"),
)


@pytest.fixture(scope="module")
def captured() -> CapturedStep:
    """Capture a step of Ants that stay within narrow heights, so that episodes end for every reason.

    The integrator is the one that takes the fewest launches.
    """
    task = Task.of(dappo_batch.compile_class_table("ant", physics="euler"))
    task = dataclasses.replace(task, height=(0.66, 0.84))
    worlds = Worlds(task, KEYS, max_episode_steps=LIMIT)
    worlds.draws.onset_range.assign(np.array([0, 2], dtype=np.int32))
    sizes = (worlds.obs_dim, worlds.code_length, worlds.action_dim)
    policy = Policy(COUNT, *sizes, HIDDEN)
    rng = np.random.default_rng(0)
    actor, critic = (weights((sizes[0], *HIDDEN, outputs), rng) for outputs in (sizes[2], 1))
    policy.assign(actor, critic, np.full(sizes[2], -0.5))
    policy.normalizer.assign((np.zeros(sizes[0] - sizes[1]), np.ones(sizes[0] - sizes[1])), 4.0)
    return CapturedStep(worlds, policy, Rollout(HORIZON, COUNT, sizes[0], sizes[2]), KEYS + 5)


def buffers(rollout: Rollout) -> dict[str, NDArray[np.generic]]:
    """Return copies of all buffers that a learner reads."""
    return {name: getattr(rollout, name).numpy().copy() for name in BUFFERS}


def begin(captured: CapturedStep) -> None:
    """Reset everything, and fill the buffers with wrong values."""
    captured.worlds.reset(keys=KEYS)
    for name in BUFFERS:
        array = getattr(captured.rollout, name)
        array.fill_(np.nan if array.dtype == wp.float32 else 1)


def test_launches_captures_and_replays_are_bit_identical(captured: CapturedStep) -> None:
    begin(captured)
    captured.rollout.row.zero_()
    captured.rollout.step.assign(np.array([1000], dtype=np.uint64))
    for _ in range(HORIZON):
        captured.step()
    captured.policy.evaluate(captured.worlds.obs)
    wp.copy(captured.rollout.last_values, captured.policy.values)
    eager = buffers(captured.rollout)
    rollouts = []
    for _ in range(2):
        begin(captured)
        rollouts.append(buffers(captured.collect(first_step=1000)))
    for replayed in rollouts:
        for name, expected in eager.items():
            np.testing.assert_array_equal(replayed[name], expected, err_msg=name)
    assert np.isfinite(eager["obs"]).all()
    assert eager["truncated"].any()
    assert (eager["terminated"] & ~eager["truncated"]).any()
    assert len(np.unique(eager["damage_class"])) > 2


def test_a_rollout_continues_where_the_last_one_ended(captured: CapturedStep) -> None:
    begin(captured)
    first = buffers(captured.collect(first_step=0))
    second = buffers(captured.collect(first_step=HORIZON))
    assert not np.array_equal(first["actions"][0], second["actions"][0])
    actor = captured.policy.actor.parameters.numpy()
    critic = captured.policy.critic.parameters.numpy()
    sizes = (first["obs"].shape[2], *HIDDEN)
    rows = second["obs"].astype(np.float64)
    rows[..., :-8] = np.clip(rows[..., :-8], -10.0, 10.0)
    rows[..., -8:] *= 4.0
    rows = rows.reshape(HORIZON * COUNT, -1)
    means = numpy_mlp(actor, (*sizes, 8), rows).reshape(second["means"].shape)
    np.testing.assert_allclose(second["means"], means, rtol=1e-4, atol=1e-5)
    values = numpy_mlp(critic, (*sizes, 1), rows).reshape(HORIZON, COUNT)
    np.testing.assert_allclose(second["values"], values, rtol=1e-4, atol=1e-5)
    # The value after the last step of a rollout is that of the first observation of the next.
    np.testing.assert_array_equal(first["last_values"][:, 0], second["values"][0])


def test_final_values_are_recorded_only_for_truncated_episodes(captured: CapturedStep) -> None:
    begin(captured)
    rollout = buffers(captured.collect(first_step=7))
    cut = rollout["truncated"] & ~rollout["terminated"]
    assert cut.any()
    assert (rollout["final_values"][~cut] == 0.0).all()
    assert (rollout["final_values"][cut] != 0.0).all()
    # They are values of the observation before the reset, not of the one after it.
    following = rollout["values"][1:][cut[:-1]]
    assert (rollout["final_values"][:-1][cut[:-1]] != following).all()


def test_new_weights_and_class_distributions_take_effect_without_a_new_capture(
    captured: CapturedStep,
) -> None:
    begin(captured)
    before = buffers(captured.collect(first_step=0))
    parameters = captured.policy.actor.parameters
    old, cumulative = parameters.numpy().copy(), captured.worlds.draws.cumulative.numpy().copy()
    try:
        parameters.assign(old + np.float32(0.1))
        healthy = np.ones_like(cumulative)
        captured.worlds.draws.cumulative.assign(healthy)
        begin(captured)
        after = buffers(captured.collect(first_step=0))
    finally:
        parameters.assign(old)
        captured.worlds.draws.cumulative.assign(cumulative)
    assert before["damage_class"].any()
    assert not after["damage_class"].any()
    assert (before["means"] != after["means"]).any(axis=2).all()


def test_a_policy_whose_actions_are_not_finite_is_an_error(captured: CapturedStep) -> None:
    begin(captured)
    log_std = captured.policy.log_std.numpy().copy()
    captured.policy.log_std.fill_(np.nan)
    try:
        expected = f"contain {HORIZON * COUNT * 8} numbers that are not finite"
        with pytest.raises(FloatingPointError, match=expected):
            captured.collect(first_step=0)
    finally:
        captured.policy.log_std.assign(log_std)
