"""Physics that diverges ends the episode in the same way on every backend, and is counted."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import dappo_batch
from dappo_batch import ClassTable, DamageVectorEnv, SimulationError

from .command_line import ITERATION, TINY, metrics
from .command_line import dappo_batch as command

State = tuple[NDArray[np.float64], NDArray[np.float64]]


@pytest.fixture(autouse=True)
def _log_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Keep MUJOCO_LOG.TXT, which MuJoCo writes its warnings to, out of the repository."""
    monkeypatch.chdir(tmp_path)


@pytest.fixture(params=["lanes-f32", "lanes-f64", "mujoco-f64"])
def options(request: pytest.FixtureRequest) -> dict[str, Any]:
    """Run the test once with each backend and precision."""
    backend, precision = request.param.split("-")
    return {"backend": backend, "precision": precision, "seed": 0}


def diverging(model: mujoco.MjModel) -> dict[str, State]:
    """Return states that MuJoCo does not go on from."""
    states: dict[str, State] = {}

    def add(name: str, field: int, entry: int | slice, value: float) -> None:
        states[name] = (model.qpos0.copy(), np.zeros(model.nv))
        states[name][field][entry] = value

    add("x beyond all numbers", 0, 0, 1e308)
    add("a joint beyond bounds", 0, 8, 2e10)
    add("a joint faster than light", 1, 8, -1e308)
    # The floor would stop a fall within the step, so it is a race.
    add("racing beyond bounds", 1, 0, 2e10)
    # Position and velocity are within bounds, the acceleration is not.
    add("spinning", 1, slice(3, 6), 1e6)
    return states


def calm(model: mujoco.MjModel) -> dict[str, State]:
    """Return extreme states that do not diverge in MuJoCo."""
    far = model.qpos0.copy()
    far[:2] = (1e6, -1e6)
    return {"reference pose": (model.qpos0, np.zeros(model.nv)), "far away": (far, np.zeros(model.nv))}


def placed(envs: DamageVectorEnv, states: list[State]) -> NDArray[np.float32]:
    qpos, qvel = map(np.array, zip(*states, strict=True))
    return envs.set_state(qpos, qvel)


def test_a_diverged_robot_fails_and_stands_in_the_reference_pose_of_its_class(
    table: ClassTable, options: dict[str, Any]
) -> None:
    model = table.models[0]
    wild, tame = diverging(model), calm(model)
    count = len(wild) + len(tame)
    classes = np.arange(count) * 3
    envs = dappo_batch.make_vec(table, count, autoreset="disabled", **options)
    envs.reset(options={"damage_class": classes})
    start = (model.qpos0, np.zeros(model.nv))
    standing = placed(envs, [start] * count)
    assert envs.diverged == 0
    placed(envs, [*wild.values(), *tame.values()])
    actions = np.ones(envs.action_space.shape, dtype=np.float32)
    obs, rewards, terminated, truncated, infos = envs.step(actions)

    assert dict(zip([*wild, *tame], terminated, strict=True)) == dict.fromkeys(wild, True) | dict.fromkeys(
        tame, False
    )
    assert not truncated.any()
    assert envs.diverged == len(wild)
    failed = slice(len(wild))
    np.testing.assert_array_equal(rewards[failed], 0.0)
    np.testing.assert_array_equal(infos["forward_velocity"][failed], 0.0)
    np.testing.assert_array_equal(obs[failed], standing[failed])
    qpos, qvel = envs.get_state()
    np.testing.assert_allclose(qpos[failed], np.tile(model.qpos0, (len(wild), 1)), rtol=0.0, atol=1e-7)
    np.testing.assert_array_equal(qvel[failed], 0.0)
    assert np.isfinite(obs).all()
    envs.close()
    with pytest.raises(SimulationError, match="closed"):
        _ = envs.diverged


def test_a_diverged_robot_does_not_change_the_others(
    assert_identical: Callable[..., None], ant_table: ClassTable, options: dict[str, Any]
) -> None:
    model = ant_table.models[0]
    wild = list(diverging(model).values())
    start = (model.qpos0, np.zeros(model.nv))
    results = []
    for others in (wild, [start] * len(wild)):
        envs = dappo_batch.make_vec(ant_table, len(wild) + 1, autoreset="same_step", **options)
        envs.reset()
        placed(envs, [*others, start])
        rng = np.random.default_rng(0)
        rows = []
        for _ in range(10):
            obs, rewards, *_ = envs.step(rng.uniform(-1, 1, envs.action_space.shape).astype(np.float32))
            assert np.isfinite(obs).all()
            rows.append((obs[-1], rewards[-1:]))
        results.append(tuple(rows))
    assert_identical(*results)


def test_the_next_episode_begins_as_after_any_other_end(
    assert_identical: Callable[..., None], table: ClassTable, options: dict[str, Any]
) -> None:
    model = table.models[0]
    wild = list(diverging(model).values())
    low = model.qpos0.copy()
    low[2] = 100.0  # too high is a fall too
    envs, falling = (
        dappo_batch.make_vec(table, len(wild), autoreset="same_step", **options) for _ in range(2)
    )
    actions = np.zeros(envs.action_space.shape, dtype=np.float32)
    for episode in range(3):
        for vector, states in ((envs, wild), (falling, [(low, np.zeros(model.nv))] * len(wild))):
            if episode == 0:
                vector.reset()
            placed(vector, states)
        obs, _, terminated, _, infos = envs.step(actions)
        other_obs, _, other_terminated, _, _ = falling.step(actions)
        assert terminated.all()
        assert other_terminated.all()
        assert_identical(obs, other_obs)
        assert all(np.isfinite(last).all() for last in infos["final_obs"])
        np.testing.assert_array_equal(infos["final_info"]["forward_velocity"], 0.0)
        assert (envs.diverged, falling.diverged) == ((episode + 1) * len(wild), 0)


def exploding_ant(folder: Path) -> Path:
    """Write an Ant whose motors are ten billion times too strong."""
    shutil.copytree(Path(dappo_batch.load_robot("ant").path).parent, folder)
    mjcf = folder / "ant.xml"
    text = mjcf.read_text()
    assert text.count('gear="150"') == 1
    mjcf.write_text(text.replace('gear="150"', 'gear="1.5e12"'))
    return folder / "ant.toml"


def test_a_training_reports_divergences_and_continues(tmp_path: Path, backend: str) -> None:
    robot, run = exploding_ant(tmp_path / "robot"), tmp_path / "run"
    arguments = ("--backend", backend, "--steps", str(2 * ITERATION), *TINY)
    _, err = command("train", "--robot", robot, "--run", run, *arguments, cwd=tmp_path)
    lines = metrics(run)
    counts = [line["diverged"] for line in lines]
    assert all(0 < count <= ITERATION for count in counts)
    assert [line["episodes"] * line["fall_rate"] for line in lines] == pytest.approx(counts)
    assert f"divergences of the physics: {sum(counts)};" in err


def test_a_stable_training_reports_no_divergence(tmp_path: Path, backend: str) -> None:
    run = tmp_path / "run"
    _, err = command("train", "--run", run, "--backend", backend, "--steps", str(ITERATION), *TINY)
    assert [line["diverged"] for line in metrics(run)] == [0]
    assert "diverge" not in err
