"""Onset, time limit and endings of the kernels against NumPy."""

from __future__ import annotations

import numpy as np
import pytest

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

from dappo_batch.kernels.episode import Endings, Episodes, count_step, keep_final, strike
from dappo_batch.kernels.outcome import Outcome

COUNT = 200


def episodes_at(step: np.ndarray, onset: np.ndarray, drawn: np.ndarray, in_force: np.ndarray) -> Episodes:
    """Return running episodes."""
    episodes = Episodes.before_the_first(np.arange(len(step), dtype=np.uint64))
    for name, value in (("step", step), ("onset", onset), ("drawn_class", drawn), ("damage_class", in_force)):
        getattr(episodes, name).assign(value.astype(np.int32))
    return episodes


def test_damage_strikes_before_the_step_whose_number_is_the_onset() -> None:
    rng = np.random.default_rng(0)
    step, onset, drawn = (rng.integers(0, 4, COUNT) for _ in range(3))
    episodes = episodes_at(step, onset, drawn, np.zeros(COUNT))
    struck = wp.array(rng.random(COUNT) < 0.5)
    strike(episodes, struck)
    expected = (onset > 0) & (step == onset) & (drawn != 0)
    assert 0 < expected.sum() < COUNT
    np.testing.assert_array_equal(struck.numpy(), expected)
    np.testing.assert_array_equal(episodes.damage_class.numpy(), np.where(expected, drawn, 0))


def test_episodes_end_by_failure_or_at_their_time_limit_and_in_the_last_step_by_both() -> None:
    rng = np.random.default_rng(1)
    step = rng.integers(0, 12, COUNT)
    failed = rng.random(COUNT) < 0.3
    episodes = episodes_at(step, step, step, step)
    outcome = Outcome.zeros(COUNT)
    outcome.terminated.assign(failed)
    endings = Endings.zeros(COUNT, 3, max_episode_steps=10)
    for flags in (endings.truncated, endings.ended):
        flags.assign(rng.random(COUNT) < 0.5)
    count_step(episodes, outcome, endings)
    truncated = step + 1 >= 10
    assert (truncated & failed).any()
    np.testing.assert_array_equal(episodes.step.numpy(), step + 1)
    np.testing.assert_array_equal(endings.truncated.numpy(), truncated)
    np.testing.assert_array_equal(endings.ended.numpy(), truncated | failed)


def test_the_last_observation_of_ended_episodes_alone_is_kept() -> None:
    rng = np.random.default_rng(2)
    classes, onset = rng.integers(0, 33, COUNT), rng.integers(0, 9, COUNT)
    episodes = episodes_at(onset, onset, classes, classes)
    endings = Endings.zeros(COUNT, 5, max_episode_steps=10)
    endings.final_obs.fill_(np.nan)
    endings.damage_class.fill_(-1)
    endings.onset.fill_(-1)
    ended = rng.random(COUNT) < 0.4
    endings.ended.assign(ended)
    obs = rng.normal(size=(COUNT, 5)).astype(np.float32)
    keep_final(episodes, wp.array(obs), endings)
    np.testing.assert_array_equal(endings.final_obs.numpy()[ended], obs[ended])
    assert np.isnan(endings.final_obs.numpy()[~ended]).all()
    np.testing.assert_array_equal(endings.damage_class.numpy(), classes)
    np.testing.assert_array_equal(endings.onset.numpy(), onset)
