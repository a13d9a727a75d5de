"""Whole episodes in the vector env: single precision, thread counts and fuzz."""

from __future__ import annotations

import numpy as np
import pytest

import dappo_batch
from dappo_batch import ClassTable

WORLDS = 4096


def _episode_statistics(table: ClassTable, precision: str, steps: int) -> dict[str, tuple[float, float]]:
    """Return mean and standard error of what episodes under random actions look like."""
    envs = dappo_batch.make_vec(
        table, WORLDS, backend="lanes", precision=precision, seed=0, observe_damage=False, copy=False
    )
    obs, _ = envs.reset()
    rng = np.random.default_rng(0)
    falls = np.zeros(WORLDS)
    speed, contacts, height = np.zeros(WORLDS), np.zeros(WORLDS), np.zeros(WORLDS)
    for _ in range(steps):
        actions = rng.uniform(-1, 1, (WORLDS, envs.single_action_space.shape[0])).astype(np.float32)
        obs, _, terminated, _, infos = envs.step(actions)
        assert np.isfinite(obs).all()
        falls += terminated
        speed += infos["forward_velocity"] / steps
        height += obs[:, 0] / steps
        state = envs.table.models[0].nq - 2 + envs.table.models[0].nv
        contacts += (obs[:, state:] != 0).mean(1) / steps
    envs.close()
    values = {"falls": falls, "forward velocity": speed, "height": height, "contacts": contacts}
    return {name: (float(x.mean()), float(x.std() / np.sqrt(WORLDS))) for name, x in values.items()}


@pytest.mark.slow
def test_episodes_in_single_precision_look_like_those_in_double(table: ClassTable) -> None:
    single, double = (_episode_statistics(table, precision, 150) for precision in ("f32", "f64"))
    for name, (mean, error) in double.items():
        # Chaos makes the episodes independent after a while: four standard errors of a difference.
        tolerance = 4.0 * np.hypot(error, single[name][1])
        assert abs(single[name][0] - mean) < tolerance, (name, single[name], double[name])


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_results_depend_neither_on_threads_nor_on_the_number_of_envs(
    table: ClassTable, precision: str
) -> None:
    def run(num_envs: int, threads: int) -> np.ndarray:
        envs = dappo_batch.make_vec(
            table, num_envs, backend="lanes", precision=precision, seed=3, threads=threads
        )
        envs.reset()
        rng = np.random.default_rng(5)
        rows = []
        for _ in range(40):
            actions = rng.uniform(-1, 1, (64, envs.single_action_space.shape[0])).astype(np.float32)
            obs, rewards, terminated, _, _ = envs.step(actions[:num_envs])
            rows.append(np.column_stack([obs, rewards, terminated])[:13])
        envs.close()
        return np.array(rows)

    expected = run(64, 1)
    assert np.array_equal(run(64, 2), expected)
    assert np.array_equal(run(13, 1), expected)


def test_fuzzed_states_and_actions_neither_panic_nor_diverge_alone(table: ClassTable) -> None:
    """Wild states may end an episode at once, but the observation stays finite where MuJoCo's would."""
    rng = np.random.default_rng(7)
    envs = dappo_batch.make_vec(table, 256, backend="lanes", precision="f32", seed=1)
    envs.reset()
    model = table.models[0]
    for scale in (0.1, 1.0, 10.0, 100.0):
        qpos = model.qpos0 + scale * rng.normal(size=(256, model.nq))
        qvel = scale * rng.normal(size=(256, model.nv))
        obs = envs.set_state(qpos, qvel)
        assert np.isfinite(obs).all()
        for _ in range(5):
            actions = rng.choice([-1e6, -1.0, 0.0, 1.0, 1e6], (256, model.nu)).astype(np.float32)
            obs, rewards, _, _, _ = envs.step(actions)
            assert np.isfinite(rewards).all()
            # Ended episodes begin anew, so that nothing non-finite is left.
            assert np.isfinite(obs).mean() > 0.9
    for _ in range(3):
        obs, _, _, _, _ = envs.step(np.zeros((256, model.nu), dtype=np.float32))
    assert np.isfinite(obs).all()
    envs.close()
