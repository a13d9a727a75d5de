"""A training learns: the healthy Ant walks forward after 600 000 env steps, some ten seconds of one core."""

from __future__ import annotations

from pathlib import Path

import pytest

import dappo_batch
from dappo_batch.commands import TrainingOptions

SMALL: TrainingOptions = {
    "healthy": True,
    "num_envs": 64,
    "threads": 1,
    "set": {
        "horizon": 64,
        "ppo": {"hidden": [64, 64], "minibatch_size": 1024, "value_minibatch_size": 1024},
        "damage.max_damaged_limbs": 0,
        "evaluation.episodes": 16,
        "checkpoint.every": 1000,
    },
}


def forward_reward(run: Path, steps: int) -> float:
    """Train for so many env steps; return the mean forward reward of an episode without exploration noise."""
    trained = dappo_batch.train(run, total_steps=steps, seed=0, **SMALL)
    (mean,) = trained.per_class["true"]["forward_reward"].tolist()
    return float(mean)


@pytest.mark.slow
def test_the_healthy_ant_learns_to_walk(tmp_path: Path) -> None:
    """Another processor rounds differently, which makes another training of it, as another seed does.

    Five seeds reached 361 to 909, and three of them 180 to 314 with two thirds of the steps. Another PPO, of
    ordinary sizes, has 298 after a million steps.
    """
    assert abs(forward_reward(tmp_path / "untrained", 1)) < 20.0
    assert forward_reward(tmp_path / "trained", 600_000) > 100.0
