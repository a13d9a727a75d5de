"""Onset, time limit and ends of episodes of the kernels compared with NumPy."""

from __future__ import annotations

import numpy as np
import pytest

wp = pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

from dappo_batch.kernels.episode import EpisodeEnds, Episodes, activate_damage, count_step, save_final
from dappo_batch.kernels.outcome import Outcome

COUNT = 200


def episodes_at(step: np.ndarray, onset: np.ndarray, drawn: np.ndarray, active: np.ndarray) -> Episodes:
    """Return running episodes."""
    episodes = Episodes.unstarted(np.arange(len(step), dtype=np.uint64))
    for name, value in (("step", step), ("onset", onset), ("drawn_class", drawn), ("damage_class", active)):
        getattr(episodes, name).assign(value.astype(np.int32))
    return episodes


def test_damage_is_activated_before_the_step_whose_number_is_the_onset() -> None:
    rng = np.random.default_rng(0)
    step, onset, drawn = (rng.integers(0, 4, COUNT) for _ in range(3))
    episodes = episodes_at(step, onset, drawn, np.zeros(COUNT))
    struck = wp.array(rng.random(COUNT) < 0.5)
    activate_damage(episodes, struck)
    expected = (onset > 0) & (step == onset) & (drawn != 0)
    assert 0 < expected.sum() < COUNT
    np.testing.assert_array_equal(struck.numpy(), expected)
    np.testing.assert_array_equal(episodes.damage_class.numpy(), np.where(expected, drawn, 0))


def test_episodes_terminate_or_are_truncated_and_in_the_last_step_can_be_both() -> None:
    rng = np.random.default_rng(1)
    step = rng.integers(0, 12, COUNT)
    failed = rng.random(COUNT) < 0.3
    episodes = episodes_at(step, step, step, step)
    outcome = Outcome.zeros(COUNT)
    outcome.terminated.assign(failed)
    ends = EpisodeEnds.zeros(COUNT, 3, max_episode_steps=10)
    for flags in (ends.truncated, ends.ended):
        flags.assign(rng.random(COUNT) < 0.5)
    count_step(episodes, outcome, ends)
    truncated = step + 1 >= 10
    assert (truncated & failed).any()
    np.testing.assert_array_equal(episodes.step.numpy(), step + 1)
    np.testing.assert_array_equal(ends.truncated.numpy(), truncated)
    np.testing.assert_array_equal(ends.ended.numpy(), truncated | failed)


def test_only_the_last_observations_of_ended_episodes_are_saved() -> None:
    rng = np.random.default_rng(2)
    classes, onset = rng.integers(0, 33, COUNT), rng.integers(0, 9, COUNT)
    episodes = episodes_at(onset, onset, classes, classes)
    ends = EpisodeEnds.zeros(COUNT, 5, max_episode_steps=10)
    ends.final_obs.fill_(np.nan)
    ends.damage_class.fill_(-1)
    ends.onset.fill_(-1)
    ended = rng.random(COUNT) < 0.4
    ends.ended.assign(ended)
    obs = rng.normal(size=(COUNT, 5)).astype(np.float32)
    save_final(episodes, wp.array(obs), ends)
    np.testing.assert_array_equal(ends.final_obs.numpy()[ended], obs[ended])
    assert np.isnan(ends.final_obs.numpy()[~ended]).all()
    np.testing.assert_array_equal(ends.damage_class.numpy(), classes)
    np.testing.assert_array_equal(ends.onset.numpy(), onset)
