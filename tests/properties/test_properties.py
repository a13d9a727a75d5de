"""Properties that hold for every valid input."""

from __future__ import annotations

import json
import math
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import dappo_batch
from dappo_batch import DamageSpace
from dappo_batch._core import run_cli

from .fuzz.mutate import to_toml

TYPES = ("jammed_joint", "missing_toe", "weak_motor")
SPACES = st.integers(1, 5).flatmap(
    lambda limbs: st.builds(
        DamageSpace,
        st.just(limbs),
        st.lists(st.sampled_from(TYPES), min_size=1, max_size=3, unique=True),
        st.integers(1, min(limbs, 3)),
    )
)
SCALARS = st.one_of(
    st.booleans(), st.integers(-(2**63), 2**63 - 1), st.floats(allow_nan=False), st.text(max_size=9)
)
TREES = st.dictionaries(
    st.text(max_size=5),
    st.recursive(
        SCALARS,
        lambda below: st.lists(below, max_size=3) | st.dictionaries(st.text(max_size=5), below, max_size=3),
    ),
    max_size=5,
)


@given(SPACES)
@settings(max_examples=60)
def test_names_and_codes_of_damage_classes_are_unique_and_read_back(space: DamageSpace) -> None:
    codes = {tuple(damage.code) for damage in space.classes}
    assert len(codes) == len({damage.name for damage in space.classes}) == len(space)
    for damage in space.classes:
        assert space.parse(damage.name) == damage.id == space.parse(damage.id)
        # Every damaged limb sets one entry: that of its type.
        assert sum(damage.code) == len(damage.damages)


@given(SPACES)
@settings(max_examples=60)
def test_there_is_a_class_for_every_choice_of_limbs_and_types(space: DamageSpace) -> None:
    types, limits = len(space.types), range(space.max_damaged_limbs + 1)
    assert len(space) == sum(math.comb(space.limbs, many) * types**many for many in limits)


@given(SPACES, st.randoms(use_true_random=False))
@settings(max_examples=100)
def test_the_order_of_damages_in_a_spec_does_not_matter(space: DamageSpace, rng: Any) -> None:  # noqa: ANN401
    damage = rng.choice(space.classes)
    parts = damage.name.split("+")
    rng.shuffle(parts)
    assert space.parse("+".join(parts)) == damage.id


@given(TREES)
def test_the_toml_of_a_tree_reads_back(tree: dict[str, Any]) -> None:
    assert tomllib.loads(to_toml(tree)) == tree


CONFIGS = st.fixed_dictionaries(
    {
        "seed": st.integers(0, 2**63 - 1),
        "total_steps": st.integers(1, 2**63 - 1),
        "horizon": st.integers(1, 4096),
        "env.num_envs": st.integers(1, 4096),
        "env.observe_damage": st.booleans(),
        "env.max_episode_steps": st.integers(1, 10_000),
        "damage.severity": st.floats(0.0, 1.0, exclude_min=True),
        "ppo.gamma": st.floats(0.5, 0.999),
        "ppo.hidden": st.lists(st.integers(1, 512), min_size=1, max_size=4),
        "evaluation.episodes": st.integers(1, 1000),
    }
)


@given(config=CONFIGS)
@settings(max_examples=20)
def test_a_configuration_prints_as_what_it_was_set_to_and_reads_back_equal(
    config: dict[str, Any], tmp_path_factory: pytest.TempPathFactory, capfd: pytest.CaptureFixture[str]
) -> None:
    settings_ = [f"{key}={json.dumps(value)}" for key, value in config.items()]
    capfd.readouterr()
    assert run_cli(["config", "--set", *settings_]) == 0
    printed = capfd.readouterr().out
    found = tomllib.loads(printed)
    for key, value in config.items():
        section, _, name = key.rpartition(".")
        assert (found[section] if section else found)[name] == value
    path = tmp_path_factory.mktemp("config") / "config.toml"
    path.write_text(printed)
    assert run_cli(["config", "--config", str(path)]) == 0
    assert capfd.readouterr().out == printed


@pytest.fixture(scope="module")
def policy(valid_files: Path) -> dappo_batch.Policy:
    """Read the tiny policy."""
    return dappo_batch.Policy.load(valid_files / "run")


@given(st.integers(1, 40), st.randoms(use_true_random=False))
@settings(max_examples=30)
def test_a_policy_acts_for_each_robot_by_itself(policy: dappo_batch.Policy, robots: int, rng: Any) -> None:  # noqa: ANN401
    draws = np.random.default_rng(rng.getrandbits(32))
    obs = draws.normal(size=(robots, policy.obs_dim)).astype(np.float32)
    classes = draws.integers(len(policy.class_names), size=robots)
    together = policy.act(obs, damage_class=classes)
    one = int(draws.integers(robots))
    alone = policy.act(obs[one], damage_class=policy.class_names[classes[one]])
    np.testing.assert_allclose(together[one], alone, rtol=1e-5, atol=1e-6)
