"""Recurrent policies: `train --lstm UNITS`, and what takes such a policy."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import onnxruntime
import pytest
from numpy.typing import NDArray

import dappo_batch
from dappo_batch import ConfigError, Policy, ShapeError

from .command_line import TINY, dappo_batch_many
from .command_line import dappo_batch as command
from .test_export import example

UNITS = 6


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("recurrent")
    recurrent = ("train", *TINY, "--unaware", "--lstm", str(UNITS))
    done = dappo_batch_many(
        (*recurrent, "--steps", "256", "--run", root / "straight"),
        (*recurrent, "--steps", "128", "--run", root / "halved"),
        ("train", *TINY, "--lstm", str(UNITS), "--steps", "128", "--run", root / "aware"),
        ("train", *TINY, "--steps", "64", "--run", root / "plain"),
    )
    assert [code for code, _, _ in done] == [0] * len(done), done
    return root


def test_a_resumed_training_goes_on_with_what_the_policy_remembers(runs: Path) -> None:
    assert dappo_batch.load_run(runs / "halved").config["ppo"]["lstm"] == UNITS
    resumed = dappo_batch.resume(runs / "halved", total_steps=256, threads=1)
    straight = dappo_batch.load_run(runs / "straight")
    for name in ("kl", "value_loss", "explained_variance"):
        np.testing.assert_array_equal(resumed.metrics[name], straight.metrics[name])
    obs = np.random.default_rng(0).normal(size=(2, Policy.load(runs / "straight").obs_dim))
    one, other = (Policy.load(runs / name) for name in ("straight", "halved"))
    steps = (policy.step(obs, policy.initial_state(2)) for policy in (one, other))
    for got, expected in zip(*steps, strict=True):
        np.testing.assert_array_equal(got, expected)


def test_an_evaluation_goes_on_with_the_state_and_begins_each_episode_anew(runs: Path) -> None:
    """`Policy.step` as a function in the place of the policy gives the same results."""
    policy = Policy.load(runs / "straight")

    class Recurrent:
        state: NDArray[np.float32] | None

        def reset(self) -> None:
            self.state = None

        def __call__(self, obs: NDArray[np.float32]) -> NDArray[np.float32]:
            if self.state is None:
                self.state = policy.initial_state(len(obs))
            actions, self.state = policy.step(obs, self.state)
            return actions

    own, outside = (
        dappo_batch.evaluate(runs / "straight", act=act, episodes=1, seed=5, threads=1).runs[0]
        for act in (None, Recurrent())
    )
    assert own.classes == outside.classes


def test_an_export_in_onnx_takes_and_returns_the_state(runs: Path, tmp_path: Path) -> None:
    for name in ("straight", "aware"):
        folder = dappo_batch.export(runs / name, tmp_path / name)
        header = json.loads((folder / "export.json").read_text())["policy"]
        assert header["lstm"] == UNITS
        session = onnxruntime.InferenceSession(folder / "policy.onnx")
        policies = Policy.load(runs / name), Policy.from_export(folder)
        rng = np.random.default_rng(1)
        hidden = cell = np.zeros((3, UNITS), np.float32)
        states = [policy.initial_state(3) for policy in policies]
        for _ in range(4):
            obs = rng.normal(size=(3, policies[0].obs_dim + policies[0].code_length)).astype(np.float32)
            found = [policy.step(obs, state) for policy, state in zip(policies, states, strict=True)]
            states = [state for _, state in found]
            np.testing.assert_array_equal(found[0][0], found[1][0])
            _, mean, hidden, cell = session.run(None, {"obs": obs, "hidden": hidden, "cell": cell})
            np.testing.assert_allclose(mean, found[0][0], atol=2e-6)
            np.testing.assert_allclose(np.stack([hidden, cell], 1), states[0], atol=2e-6)
        assert np.abs(states[0]).max() > 1e-3
        driver, state = example().PolicyAlone(folder), policies[0].initial_state()
        for row in rng.normal(size=(3, policies[0].obs_dim)).astype(np.float32):
            damage_class = "healthy" if policies[0].observes_damage else None
            action, state = policies[0].step(row, state, damage_class=damage_class)
            np.testing.assert_allclose(driver.act(row), np.clip(action, -1, 1), atol=2e-6)


def test_reports_simulate_recurrent_policies(runs: Path, tmp_path: Path, opengl: None) -> None:
    page = tmp_path / "report.html"
    command("report", runs / "aware", runs / "plain", "--out", page)
    text = page.read_text(encoding="utf-8")
    assert f"lstm {UNITS}" in text
    assert "data:image/jpeg" in text


def test_a_recurrent_policy_is_refused_where_its_state_would_be_lost(runs: Path, tmp_path: Path) -> None:
    policy = Policy.load(runs / "aware")
    assert policy.is_recurrent
    obs = np.zeros(policy.obs_dim, np.float32)
    with pytest.raises(ConfigError, match="call `step`"):
        policy.act(obs)
    actions, state = policy.step(obs, policy.initial_state(), damage_class="healthy")
    assert actions.shape == (policy.action_dim,)
    assert state.shape == (2, UNITS)
    with pytest.raises(ShapeError, match=r"state has shape \(2, 3\), expected \(2, 6\)"):
        policy.step(obs, np.zeros((2, 3)))
    with pytest.raises(ConfigError, match="state"):
        policy.step(obs, np.full((2, UNITS), np.nan))
    _, error = command("diagnose", "collect", runs / "aware", "--out", tmp_path / "data", code=1)
    assert "is recurrent (`ppo.lstm` = 6), expected one without memory" in error
    _, error = command("train", *TINY, "env.device=warp-cpu", "--lstm", "4", "--steps", "64", code=1)
    assert "`ppo.lstm` is for the device `cpu`" in error
    with pytest.raises(ConfigError, match=r"ppo\.lstm.*networks have these layers"):
        dappo_batch.resume(runs / "straight", total_steps=512, set={"ppo.lstm": 8})


def test_a_policy_without_memory_has_a_state_without_numbers(runs: Path) -> None:
    policy = Policy.load(runs / "plain")
    assert not policy.is_recurrent
    obs = np.zeros((2, policy.obs_dim + policy.code_length), np.float32)
    actions, state = policy.step(obs, policy.initial_state(2))
    np.testing.assert_array_equal(actions, policy.act(obs))
    assert state.shape == (2, 2, 0)
