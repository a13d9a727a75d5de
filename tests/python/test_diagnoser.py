"""`Diagnoser`: a log is enough to find the twins of its training, and a damage that is plain to see."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import dappo_batch
from dappo_batch import ConfigError, Diagnoser, ShapeError

STEPS = 5
CLASSES = 9


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train an expert and a diagnoser; collect records, one step longer, that it has not seen."""
    folder = tmp_path_factory.mktemp("diagnoser")
    settings = {"horizon": 16, "ppo.hidden": [8], "evaluation.episodes": 1, "damage.max_damaged_limbs": 1}
    dappo_batch.train(folder / "expert", num_envs=4, total_steps=64, threads=1, set=settings)
    for name, rollouts, steps, seed in (("pairs", 40, STEPS, 0), ("unseen", 6, STEPS + 1, 1)):
        dappo_batch.collect_pairs(
            folder / "expert",
            folder / name,
            rollouts=rollouts,
            timesteps=steps,
            preset="residual",
            seed=seed,
            threads=1,
        )
    small = {"embedding": 32, "lstm": 32, "hidden": [32], "epochs": 30, "minibatch_size": 32}
    dappo_batch.train_diagnoser(folder / "pairs", folder / "model", threads=1, set=small)
    return folder


@pytest.fixture(scope="module")
def diagnoser(folder: Path) -> Diagnoser:
    return Diagnoser.load(folder / "model", expert=folder / "expert")


@pytest.fixture(scope="module")
def records(folder: Path) -> Any:  # noqa: ANN401 - a structured array
    return np.load(folder / "unseen" / "rollouts-000000.npy")


def log(records: Any, rollout: int) -> tuple[NDArray[np.float32], NDArray[np.float32]]:  # noqa: ANN401
    """Return what robots of all classes logged; records begin after a step, so the first one is cut off."""
    return records["damaged"][rollout], records["actions"][rollout, :, 1:]


def test_a_diagnoser_has_its_sizes_and_class_names(diagnoser: Diagnoser) -> None:
    assert (diagnoser.obs_dim, diagnoser.action_dim, diagnoser.timesteps) == (111, 8, STEPS)
    table = dappo_batch.compile_class_table("ant", max_damaged_limbs=1)
    assert diagnoser.class_names == [item.name for item in table.space.classes]


def test_twins_of_a_log_are_those_of_the_record(diagnoser: Diagnoser, records: Any) -> None:  # noqa: ANN401
    obs, actions = log(records, rollout=2)
    twins = diagnoser.twin(obs, actions)
    np.testing.assert_allclose(twins, records["twin"][2, :, 1:], rtol=0, atol=1e-5)
    np.testing.assert_array_equal(diagnoser.twin(obs[3], actions[3]), twins[3])


def test_most_logs_are_diagnosed_correctly_and_robots_are_independent(
    diagnoser: Diagnoser,
    records: Any,  # noqa: ANN401
) -> None:
    named = []
    for rollout in range(len(records)):
        obs, actions = log(records, rollout)
        probabilities = diagnoser.diagnose(obs, actions)
        np.testing.assert_allclose(probabilities.sum(axis=1), 1.0, atol=1e-5)
        np.testing.assert_allclose(diagnoser.diagnose(obs[4], actions[4]), probabilities[4], atol=1e-6)
        named.append(probabilities.argmax(axis=1))
    assert np.mean(np.array(named) == np.arange(CLASSES)) > 0.6  # chance: 1 in 9


def test_shapes_and_folders_that_do_not_fit_are_rejected(
    diagnoser: Diagnoser,
    records: Any,  # noqa: ANN401
    folder: Path,
) -> None:
    obs, actions = log(records, rollout=0)
    with pytest.raises(ShapeError, match=rf"there are {STEPS - 1} steps, expected {STEPS}"):
        diagnoser.diagnose(obs[:, :-1], actions[:, :-1])
    with pytest.raises(ShapeError, match=r"expected \[N, T \+ 1, O\]"):
        diagnoser.diagnose(obs[:, 1:], actions)
    with pytest.raises(ShapeError, match="or both without N"):
        diagnoser.twin(obs, actions[0])
    with pytest.raises(ConfigError, match=r"no config\.toml"):
        Diagnoser.load(folder / "model", expert=folder)
