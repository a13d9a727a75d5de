"""Whole episodes in the vector env: single precision, thread counts and fuzz."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import dappo_batch
from dappo_batch import ClassTable

WORLDS = 4096


def _episode_statistics(table: ClassTable, precision: str, steps: int) -> dict[str, tuple[float, float]]:
    """Return mean and standard error of statistics of episodes with random actions."""
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


@pytest.mark.parametrize(("backend", "precision"), [("lanes", "f32"), ("lanes", "f64"), ("mujoco", "f64")])
def test_fuzzed_states_and_actions_lead_to_finite_numbers(
    table: ClassTable, backend: str, precision: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # for MUJOCO_LOG.TXT
    rng = np.random.default_rng(7)
    envs = dappo_batch.make_vec(table, 256, backend=backend, precision=precision, seed=1)
    envs.reset()
    model = table.models[0]
    for scale in (0.1, 1.0, 10.0, 100.0, 1e3, 1e5, 1e9, 1e20, 1e200):
        qpos = model.qpos0 + scale * rng.normal(size=(256, model.nq))
        qvel = scale * rng.normal(size=(256, model.nv))
        envs.set_state(qpos, qvel)
        for _ in range(6):
            actions = rng.choice([-1e6, -1.0, 0.0, 1.0, 1e6], (256, model.nu)).astype(np.float32)
            obs, rewards, _, _, infos = envs.step(actions)
            assert np.isfinite(obs).all(), scale
            assert np.isfinite(rewards).all(), scale
            assert np.isfinite(infos["forward_velocity"]).all(), scale
    # States beyond MuJoCo's limits have diverged, most of them at once.
    assert envs.diverged > 3 * 256
    envs.close()


@pytest.mark.parametrize("precision", ["f32", "f64"])
def test_the_same_wild_states_end_the_episode_as_with_mujoco(
    table: ClassTable, precision: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # for MUJOCO_LOG.TXT
    count, model = 256, table.models[0]
    lanes, mujoco = (
        dappo_batch.make_vec(
            table, count, backend=name, precision=precision, autoreset="disabled", seed=1, damage="healthy"
        )
        for name in ("lanes", "mujoco")
    )
    rng = np.random.default_rng(7)
    for scale in (0.1, 1.0, 10.0, 100.0, 1e3, 1e4, 1e5, 1e6, 1e8, 1e12):
        qpos = model.qpos0 + scale * rng.normal(size=(count, model.nq))
        qvel = scale * rng.normal(size=(count, model.nv))
        actions = rng.choice([-1.0, 1.0], (count, model.nu)).astype(np.float32)
        ends, resets = [], []
        for envs in (lanes, mujoco):
            before = envs.diverged
            envs.reset()
            envs.set_state(qpos, qvel)
            ends.append(envs.step(actions)[2])
            resets.append(~envs.get_state()[1].any(1))  # only diverged robots are at rest
            assert resets[-1].sum() == envs.diverged - before
        np.testing.assert_array_equal(*ends, err_msg=str(scale))
        # MuJoCo checks every substep, the lane engine only the last one.
        assert (resets[0] == resets[1]).mean() > 0.9, scale
