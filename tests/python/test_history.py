"""`history`: policies that observe several env steps instead of the last one."""

from __future__ import annotations

import json
from collections import deque
from pathlib import Path

import numpy as np
import pytest

import dappo_batch
from dappo_batch import ConfigError, Policy

from .command_line import TINY, dappo_batch_many
from .command_line import dappo_batch as command

STEPS = 3


@pytest.mark.parametrize("robot", ["ant", "go1"])
@pytest.mark.parametrize("autoreset", ["same_step", "next_step"])
def test_each_term_shows_its_last_values_and_the_first_one_again_at_the_start(
    robot: str, autoreset: str, backend: str
) -> None:
    """Frames are stacked here as `gymnasium.wrappers.FrameStackObservation` does with ``"reset"``."""
    envs, frames = (
        dappo_batch.make_vec(
            robot,
            3,
            seed=4,
            history=history,
            max_damaged_limbs=1,
            max_episode_steps=7,
            autoreset=autoreset,
            backend=backend,
            precision="f64",
        )
        for history in (STEPS, None)
    )
    code = envs.table.space.code_length
    names, entries = envs.obs_names[:-code], frames.obs_names[:-code]
    assert envs.obs_names[-code:] == frames.obs_names[-code:]
    assert envs.single_observation_space.shape == (STEPS * len(entries) + code,) == (len(names) + code,)
    # Where the entries of each frame are, the oldest first.
    places = [[names.index(f"{name} t-{age}") for name in entries] for age in (2, 1, 0)]

    rng = np.random.default_rng(0)
    (obs, _), (frame, _) = envs.reset(), frames.reset()
    kept = [deque([row] * STEPS, STEPS) for row in frame]
    ended, ends = np.zeros(3, bool), 0
    for _ in range(25):
        for row, stack in zip(obs, kept, strict=True):
            for place, values in zip(places, stack, strict=True):
                np.testing.assert_array_equal(row[place], values[:-code])
            np.testing.assert_array_equal(row[-code:], stack[-1][-code:])
        actions = rng.uniform(-1, 1, (3, envs.single_action_space.shape[0])).astype(np.float32)
        before = ended
        (obs, rewards, *ends_of, _), (frame, others, *_, _) = envs.step(actions), frames.step(actions)
        np.testing.assert_array_equal(rewards, others)
        ended = np.logical_or(*ends_of)
        ends += int(ended.sum())
        begins = ended if autoreset == "same_step" else before
        for row, stack, begin in zip(frame, kept, begins, strict=True):
            stack.extend([row] * (STEPS if begin else 1))
    assert ends >= 6


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("history")
    done = dappo_batch_many(
        ("train", *TINY, "--unaware", "--history", "3", "--steps", "128", "--run", root / "stacked"),
        ("train", *TINY, "--unaware", "--steps", "128", "--run", root / "plain"),
    )
    assert [code for code, _, _ in done] == [0, 0], done
    return root


def test_a_run_is_evaluated_resumed_and_exported_with_its_history(runs: Path, tmp_path: Path) -> None:
    assert dappo_batch.load_run(runs / "stacked").config["env"]["history"] == 3
    stacked, plain = (Policy.load(runs / name) for name in ("stacked", "plain"))
    assert (stacked.obs_dim, plain.obs_dim) == (3 * plain.obs_dim, plain.obs_dim)
    report = dappo_batch.evaluate(runs / "stacked", compare=[runs / "plain"], threads=1)
    assert report.comparison is not None
    longer = dappo_batch.resume(runs / "stacked", total_steps=256, threads=1)
    assert longer.metrics["env_steps"][-1] == 256
    folder = dappo_batch.export(runs / "stacked", tmp_path / "export")
    names = [entry["name"] for entry in json.loads((folder / "export.json").read_text())["observation"]]
    assert names[0].endswith(" t-2")
    assert len(names) == stacked.obs_dim


def test_a_history_that_cannot_be_observed_is_an_error(runs: Path) -> None:
    for history in (0, 1001, True, 2.5):
        with pytest.raises(ConfigError, match="history must be"):
            dappo_batch.make_vec("ant", history=history)  # type: ignore[arg-type]
    _, error = command("train", *TINY, "env.history=1001", "--steps", "64", code=1)
    assert "`env.history` is 1001, expected a whole number of at least 1 and at most 1000" in error
    with pytest.raises(ConfigError, match=r"env\.history.*networks have inputs for these observations"):
        dappo_batch.resume(runs / "plain", total_steps=256, set={"env.history": 2})
