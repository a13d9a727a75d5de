"""The policy of the kernels compared with NumPy in double precision."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from numpy.typing import NDArray

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

from dappo_batch.kernels.policy import Mlp, Normalizer, Policy

from .philox_numpy import Stream

ACTION_NOISE = 3  # purpose of the stream
COUNT, OBS, CODE, ACTIONS = 30, 21, 4, 5
HIDDEN = (16, 33, 8)


def numpy_mlp(
    parameters: NDArray[np.float32], sizes: tuple[int, ...], rows: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the net's outputs [N, outputs]."""
    for number, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
        weight, parameters = np.split(parameters, [inputs * outputs])
        bias, parameters = np.split(parameters, [outputs])
        rows = rows @ weight.astype(np.float64).reshape(inputs, outputs) + bias
        if number + 2 < len(sizes):
            rows = np.tanh(rows)
    assert parameters.size == 0
    return rows


def weights(sizes: tuple[int, ...], rng: np.random.Generator) -> NDArray[np.float32]:
    """Return flat parameters, small enough that the units do not saturate."""
    parts = [
        part
        for inputs, outputs in itertools.pairwise(sizes)
        for part in (rng.normal(size=inputs * outputs) / math.sqrt(inputs), 0.3 * rng.normal(size=outputs))
    ]
    return np.concatenate(parts).astype(np.float32)


def test_a_net_equals_numpys_and_does_not_change_rows_outside_the_mask() -> None:
    rng = np.random.default_rng(0)
    sizes = (OBS, *HIDDEN, ACTIONS)
    net = Mlp(COUNT, sizes)
    net.parameters.assign(weights(sizes, rng))
    net.output.fill_(np.nan)
    rows = rng.normal(size=(COUNT, OBS)).astype(np.float32)
    mask = rng.random(COUNT) < 0.5
    net.forward(wp.array(rows), wp.array(mask))
    expected = numpy_mlp(net.parameters.numpy(), sizes, rows.astype(np.float64))
    np.testing.assert_allclose(net.output.numpy()[mask], expected[mask], rtol=1e-5, atol=1e-6)
    assert np.isnan(net.output.numpy()[~mask]).all()


def test_observations_are_normalised_and_clipped_and_the_code_is_multiplied_by_its_factor() -> None:
    rng = np.random.default_rng(1)
    tracked = OBS - CODE
    mean, variance = rng.normal(size=tracked), rng.random(tracked)
    variance[0] = 0.0  # a constant entry must not divide by zero
    obs = rng.normal(size=(COUNT, OBS)).astype(np.float32)
    obs[0, 3], obs[1, 3] = 1e6, -1e6
    normalizer = Normalizer(OBS, CODE)
    everyone = wp.full(COUNT, True, dtype=wp.bool)

    def normalised() -> NDArray[np.float32]:
        rows = wp.full((COUNT, OBS), np.nan, dtype=wp.float32)
        normalizer.apply(wp.array(obs), everyone, rows)
        result: NDArray[np.float32] = rows.numpy()
        return result

    np.testing.assert_array_equal(normalised(), obs)
    normalizer.assign((mean, 1 / np.sqrt(variance + 1e-8)), code_scale=4.0)
    expected = np.clip((obs[:, :tracked] - mean) / np.sqrt(variance + 1e-8), -10.0, 10.0)
    np.testing.assert_allclose(normalised()[:, :tracked], expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(normalised()[:, tracked:], 4.0 * obs[:, tracked:])
    normalizer.assign(None)
    np.testing.assert_array_equal(normalised(), obs)


def test_actions_log_densities_and_values_equal_numpys() -> None:
    rng = np.random.default_rng(2)
    policy = Policy(COUNT, OBS, CODE, ACTIONS, HIDDEN)
    actor, critic = (weights((OBS, *HIDDEN, outputs), rng) for outputs in (ACTIONS, 1))
    log_std = rng.normal(size=ACTIONS).astype(np.float32)
    policy.assign(actor, critic, log_std)
    mean, variance = rng.normal(size=OBS - CODE), rng.random(OBS - CODE)
    policy.normalizer.assign((mean, 1 / np.sqrt(variance + 1e-8)), code_scale=4.0)
    for array in (policy.actions, policy.log_probs, policy.means, policy.values):
        array.fill_(np.nan)
    obs = rng.normal(size=(COUNT, OBS)).astype(np.float32)
    keys, step = rng.integers(0, 2**64, COUNT, dtype=np.uint64), 2**32 + 17
    policy.act(wp.array(obs), wp.array(keys), wp.array([step], dtype=wp.uint64))

    rows = obs.astype(np.float64)
    rows[:, :-CODE] = np.clip((rows[:, :-CODE] - mean) / np.sqrt(variance + 1e-8), -10, 10)
    rows[:, -CODE:] *= 4.0
    means = numpy_mlp(actor, (OBS, *HIDDEN, ACTIONS), rows)
    noise = np.array([Stream(int(key), step, ACTION_NOISE).normals(ACTIONS) for key in keys])
    actions = means + np.exp(log_std.astype(np.float64)) * noise
    densities = -0.5 * noise**2 - log_std - 0.5 * math.log(2.0 * math.pi)
    np.testing.assert_allclose(policy.means.numpy(), means, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(policy.actions.numpy(), actions, rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(policy.log_probs.numpy(), densities.sum(1), rtol=1e-6, atol=1e-6)
    values = numpy_mlp(critic, (OBS, *HIDDEN, 1), rows)
    np.testing.assert_allclose(policy.values.numpy(), values, rtol=1e-5, atol=1e-5)
