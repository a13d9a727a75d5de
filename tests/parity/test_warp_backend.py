"""`device="warp-cpu"` of the vector env compared with the `mujoco` backend, in envs and trainings."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

import dappo_batch
from dappo_batch import ClassTable
from dappo_batch._core import collect_rollout

from .states import with_cone

COUNT, STEPS, LIMIT, SEED = 6, 9, 4, 31
TOLERANCE = 1e-3


def close(got: NDArray[Any], expected: NDArray[Any], what: str) -> None:
    """Compare physics of single precision with that of double precision."""
    np.testing.assert_allclose(got, expected, rtol=TOLERANCE, atol=TOLERANCE, err_msg=what)


@pytest.mark.parametrize("autoreset", ["next_step", "same_step"])
def test_the_vector_env_is_the_same_on_both_devices(ant_table: ClassTable, autoreset: str) -> None:
    """With elliptic cones, as the physics would differ from the first contact on otherwise."""
    table = with_cone(ant_table, mujoco.mjtCone.mjCONE_ELLIPTIC)
    options: dict[str, Any] = {
        "seed": SEED,
        "autoreset": autoreset,
        "onset": (0, 3),
        "max_episode_steps": LIMIT,
    }
    expected = dappo_batch.make_vec(table, COUNT, backend="mujoco", **options)
    got = dappo_batch.make_vec(table, COUNT, device="warp-cpu", **options)
    assert (got.backend, got.precision, got.device, got.backend_note) == ("warp", "f32", "warp-cpu", "")
    assert expected.device == "cpu"
    obs, infos = expected.reset()
    other_obs, other_infos = got.reset()
    close(other_obs, obs, "reset")
    rng = np.random.default_rng(6)
    ends = 0
    for step in range(STEPS):
        actions = rng.uniform(-1, 1, (COUNT, 8)).astype(np.float32)
        obs, rewards, terminated, truncated, infos = expected.step(actions)
        other_obs, other_rewards, other_terminated, other_truncated, other_infos = got.step(actions)
        close(other_obs, obs, f"step {step}")
        close(other_rewards, rewards, f"step {step}")
        np.testing.assert_array_equal(other_terminated, terminated)
        np.testing.assert_array_equal(other_truncated, truncated)
        ends += int((terminated | truncated).sum())
        for name in ("damage_class", "damage_onset"):
            np.testing.assert_array_equal(other_infos[name], infos[name])
        close(other_infos["forward_velocity"], infos["forward_velocity"], f"step {step}")
    assert ends >= COUNT
    state, other_state = expected.get_state(), got.get_state()
    for one, other in zip(other_state, state, strict=True):
        close(one, other, "state")
    middle = [part.astype(np.float32).astype(np.float64) for part in state]
    close(got.set_state(*middle), expected.set_state(*middle), "set_state")
    for one, other in zip(got.get_state(), middle, strict=True):
        np.testing.assert_array_equal(one, other)


SETTINGS = {
    "horizon": 3,
    "ppo.hidden": [16],
    "env.max_episode_steps": 2,
    "damage.onset": {"first": 0, "last": 1},
}
OPTIONS: dict[str, Any] = {"num_envs": 12, "physics": "euler", "seed": 5, "set": SETTINGS}


@pytest.fixture(scope="module")
def rollouts() -> tuple[dict[str, Any], dict[str, Any]]:
    """Collect the first rollout of a training on both devices."""
    host = collect_rollout(device="cpu", backend="mujoco", **OPTIONS)
    return host, collect_rollout(device="warp-cpu", **OPTIONS)


def test_a_training_begins_with_the_same_episodes_on_every_device(
    rollouts: tuple[dict[str, Any], dict[str, Any]],
) -> None:
    host, warp = rollouts
    assert list(host) == list(warp)
    for name, array in host.items():
        assert (array.shape, array.dtype) == (warp[name].shape, warp[name].dtype), name
    # Key, number, step, class, onset and "ended" of every episode.
    np.testing.assert_array_equal(warp["start_episodes"], host["start_episodes"])
    assert len(set(host["start_episodes"][:, 3].tolist())) > 1
    assert set(host["start_episodes"][:, 4].tolist()) == {0, 1}
    np.testing.assert_allclose(warp["obs"][0], host["obs"][0], rtol=0, atol=1e-5)


def test_the_first_decisions_of_a_training_are_the_same_on_every_device(
    rollouts: tuple[dict[str, Any], dict[str, Any]],
) -> None:
    host, warp = rollouts
    for name in ("actions", "means", "log_probs", "values"):
        np.testing.assert_allclose(warp[name][0], host[name][0], rtol=0, atol=1e-5, err_msg=name)
        assert np.abs(host[name][0]).max() > 0.0
    np.testing.assert_array_equal(warp["truncated"], host["truncated"])
    np.testing.assert_array_equal(warp["final_values"] != 0.0, host["final_values"] != 0.0)
    assert (host["final_values"] != 0.0).any()


def test_the_first_steps_of_a_training_in_the_air_are_the_same_on_every_device(
    rollouts: tuple[dict[str, Any], dict[str, Any]],
) -> None:
    """In the air the friction cones, in which the backends differ, do not matter."""
    host, warp = rollouts
    in_the_air = ~host["obs"][1, :, 27:111].any(axis=1) & ~host["truncated"][0]
    assert in_the_air.any()
    np.testing.assert_allclose(warp["obs"][1, in_the_air], host["obs"][1, in_the_air], rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(
        warp["rewards"][0, in_the_air], host["rewards"][0, in_the_air], rtol=1e-5, atol=1e-5
    )
