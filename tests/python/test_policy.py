"""`Policy`: a trained policy by itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import dappo_batch
from dappo_batch import ConfigError, Policy, ShapeError

from .command_line import TINY, dappo_batch_many
from .numpy_policy import mean_actions


@pytest.fixture(scope="module")
def runs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("policy")
    done = dappo_batch_many(
        ("train", *TINY, "--steps", "128", "--run", root / "aware"),
        ("train", *TINY, "--unaware", "--steps", "64", "--run", root / "unaware"),
    )
    assert [code for code, _, _ in done] == [0, 0], done
    return root


def test_a_policy_has_its_sizes_and_class_names(runs: Path) -> None:
    policy = Policy.load(runs / "aware")
    assert (policy.obs_dim, policy.action_dim, policy.env_steps) == (111, 8, 128)
    assert (policy.observes_damage, policy.code_length) == (True, 8)
    unaware = Policy.load(str(runs / "unaware"))
    assert (unaware.observes_damage, unaware.code_length) == (False, 0)
    table = dappo_batch.compile_class_table("ant", max_damaged_limbs=1)
    assert policy.class_names == [item.name for item in table.space.classes]


def test_one_observation_and_many_get_the_same_actions_whatever_way_the_damage_is_named(runs: Path) -> None:
    policy = Policy.load(runs / "aware")
    obs = np.random.default_rng(0).standard_normal((4, 111)).astype(np.float32)
    names = ["healthy", "missing_toe@1", "jammed_joint@2", "missing_toe@1"]
    ids = [policy.class_names.index(name) for name in names]
    together = policy.act(obs, damage_class=names)
    assert (together.shape, together.dtype) == ((4, 8), np.float32)
    np.testing.assert_array_equal(policy.act(obs, damage_class=ids), together)
    np.testing.assert_array_equal(policy.act(obs, damage_class=np.array(ids)), together)
    for row, name, actions in zip(obs, names, together, strict=True):
        np.testing.assert_allclose(policy.act(row, damage_class=name), actions, atol=1e-6)
    same = policy.act(obs, damage_class="missing_toe@1")
    np.testing.assert_array_equal(same[[1, 3]], together[[1, 3]])
    np.testing.assert_array_equal(policy.act(obs)[0], together[0])


def test_observations_of_envs_contain_the_code_that_the_policy_receives(runs: Path) -> None:
    policy = Policy.load(runs / "aware")
    envs = dappo_batch.make_vec("ant", 9, max_damaged_limbs=1, damage="uniform", seed=0)
    obs, _ = envs.reset(options={"damage_class": list(range(9))})
    np.testing.assert_array_equal(policy.act(obs), policy.act(obs[:, :111], damage_class=range(9)))
    np.testing.assert_allclose(policy.act(obs[3]), policy.act(obs)[3], atol=1e-6)


def test_the_damage_class_changes_the_actions_of_a_policy_that_observes_it(runs: Path) -> None:
    obs = np.zeros(111, np.float32)
    aware, unaware = Policy.load(runs / "aware"), Policy.load(runs / "unaware")
    assert (aware.act(obs) != aware.act(obs, damage_class="missing_toe@0")).any()
    assert unaware.act(obs).shape == (8,)
    with pytest.raises(ConfigError, match="does not observe damage"):
        unaware.act(obs, damage_class="missing_toe@0")


def test_actions_are_those_of_the_network_that_the_checkpoint_holds(runs: Path) -> None:
    policy = Policy.load(runs / "aware")
    obs = np.random.default_rng(1).standard_normal((9, 111)).astype(np.float32)
    space = dappo_batch.compile_class_table("ant", max_damaged_limbs=1).space
    codes = np.array([item.code for item in space.classes])
    expected = mean_actions(runs / "aware", obs, codes)
    np.testing.assert_allclose(policy.act(obs, damage_class=range(9)), expected, atol=1e-5)
    assert np.abs(expected - mean_actions(runs / "aware", obs)).max() > 1e-3, "the code matters"


def test_what_does_not_fit_is_rejected(runs: Path, tmp_path: Path) -> None:
    policy = Policy.load(runs / "aware")
    expected = r"expected \[N, 111\] \(without damage code\) and \[N\], or \[N, 119\] \(with it\)"
    with pytest.raises(ShapeError, match=rf"\[1, 118\].*{expected}"):
        policy.act(np.zeros(118))
    with pytest.raises(ShapeError, match=rf"\[1, 119\] and damage_class \[1\], {expected}"):
        policy.act(np.zeros(119), damage_class=0)
    with pytest.raises(ShapeError, match=r"\[1, 119\].*expected \[N, 111\]"):
        Policy.load(runs / "unaware").act(np.zeros(119))
    with pytest.raises(ShapeError, match=r"damage_class \[3\]"):
        policy.act(np.zeros((2, 111)), damage_class=[0, 1, 2])
    with pytest.raises(ConfigError, match="damage class 9 does not exist; the classes are 0 to 8"):
        policy.act(np.zeros(111), damage_class=9)
    with pytest.raises(ConfigError, match="missing_toe@8"):
        policy.act(np.zeros(111), damage_class="missing_toe@8")
    with pytest.raises(ConfigError, match="is not a run folder"):
        Policy.load(tmp_path / "nowhere")
