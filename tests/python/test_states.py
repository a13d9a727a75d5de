"""Saved states: steps from a restored state are bit-identical, also with hidden state."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from gymnasium.error import ResetNeeded

import dappo_batch
from dappo_batch import CheckpointError, ClassTable, ConfigError
from dappo_batch._core import run_cli
from dappo_batch.envs import DamageVectorEnv

from .command_line import ITERATION, TINY

ROBOTS = Path(__file__).parent / "robots"
OPTION = '<option timestep="0.005" integrator="implicitfast"/>'
SERVO = "<position "

# Robots whose state is more than positions and velocities: what is changed in the toy robot, what is named.
HIDDEN: dict[str, tuple[str, str, str]] = {
    "filtered servos": (
        SERVO,
        '<general dyntype="filter" dynprm="0.1" gainprm="15" biasprm="0 -15" biastype="affine" ',
        "6 activations of actuators",
    ),
    "an unfinished solution": (OPTION, OPTION.replace("/>", ' iterations="1"/>'), "iterations = 1"),
    "delayed servos": (SERVO, '<position delay="0.02" nsample="5" ', "numbers of delayed signals"),
}


def toy(folder: Path, old: str = "", new: str = "") -> ClassTable:
    """Compile the toy robot with single damages after an edit of its MJCF."""
    text = (ROBOTS / "tripod.xml").read_text()
    # The defaults of <position> are those of <general> as well.
    defaults, rest = text.split("  <worldbody>")
    if old == OPTION:
        assert defaults.count(old) == 1
        defaults = defaults.replace(old, new)
    elif old:
        assert rest.count(old) == 6
        rest = rest.replace(old, new)
    (folder / "tripod.xml").write_text(f"{defaults}  <worldbody>{rest}")
    (folder / "tripod.toml").write_text((ROBOTS / "tripod.toml").read_text())
    return dappo_batch.compile_class_table(folder / "tripod.toml", max_damaged_limbs=1)


def walked(table: ClassTable, **options: str) -> tuple[DamageVectorEnv, np.random.Generator]:
    """Return envs that have made some steps, and where their actions come from."""
    envs = dappo_batch.make_vec(table, 4, seed=0, threads=1, **options)  # type: ignore[arg-type]
    envs.reset()
    rng = np.random.default_rng(0)
    for _ in range(10):
        envs.step(rng.uniform(-1, 1, envs.action_space.shape).astype(np.float32))
    return envs, rng


def steps(envs: DamageVectorEnv, actions: np.ndarray) -> list[np.ndarray]:
    return [array.copy() for action in actions for array in envs.step(action)[:4]]


@pytest.mark.parametrize("name", HIDDEN)
def test_steps_from_a_restored_state_are_bit_identical_also_with_hidden_state(
    name: str, tmp_path: Path
) -> None:
    old, new, _ = HIDDEN[name]
    envs, rng = walked(toy(tmp_path, old, new))
    assert envs.backend == "mujoco"
    actions = rng.uniform(-1, 1, (5, *envs.action_space.shape)).astype(np.float32)
    saved = envs.save_state()
    first = steps(envs, actions)
    envs.restore_state(saved)
    for one, other in zip(first, steps(envs, actions), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("name", HIDDEN)
def test_positions_and_velocities_are_not_a_complete_state_of_such_a_robot(name: str, tmp_path: Path) -> None:
    old, new, hidden = HIDDEN[name]
    envs, rng = walked(toy(tmp_path, old, new))
    action = rng.uniform(-1, 1, envs.action_space.shape).astype(np.float32)
    state = envs.get_state()
    after = envs.step(action)[0].copy()
    with pytest.raises(ConfigError, match="more than positions and velocities") as caught:
        envs.set_state(*state)
    assert hidden in str(caught.value)
    # With the rest as after a reset the robot moves on otherwise, which is why.
    envs.set_state(*state, at_rest=True)
    np.testing.assert_array_equal(envs.get_state()[0], state[0])
    assert not np.array_equal(envs.step(action)[0], after)


@pytest.mark.parametrize("options", [{"backend": "mujoco"}, {"backend": "lanes"}, {"precision": "f64"}])
def test_a_saved_state_holds_the_episodes_as_well(options: dict[str, str]) -> None:
    table = dappo_batch.compile_class_table("ant", max_damaged_limbs=1)
    envs, rng = walked(table, **options)
    obs, saved = envs.get_state(), envs.save_state()
    actions = rng.uniform(-1, 1, (3, *envs.action_space.shape)).astype(np.float32)
    first = steps(envs, actions)
    restored = envs.restore_state(saved)
    for one, other in zip(obs, envs.get_state(), strict=True):
        np.testing.assert_array_equal(one, other)
    for one, other in zip(first, steps(envs, actions), strict=True):
        np.testing.assert_array_equal(one, other)
    # Another env of the same kind can restore it too.
    other_envs = dappo_batch.make_vec(table, 4, seed=7, threads=1, **options)  # type: ignore[arg-type]
    np.testing.assert_array_equal(other_envs.restore_state(saved), restored)
    for one, other in zip(first, steps(other_envs, actions), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_single_env_can_be_restored_too() -> None:
    env = dappo_batch.DamageEnv("ant", damage="healthy", backend="mujoco")
    obs, _ = env.reset(seed=0)
    saved, action = env.save_state(), np.full(8, 0.5, dtype=np.float32)
    first = env.step(action)
    np.testing.assert_array_equal(env.restore_state(saved), obs)
    second = env.step(action)
    np.testing.assert_array_equal(first[0], second[0])
    assert first[1] == second[1]


def test_a_restored_episode_that_had_ended_is_still_ended(tmp_path: Path) -> None:
    envs = dappo_batch.make_vec(toy(tmp_path), 2, seed=0, autoreset="disabled", max_episode_steps=1)
    envs.reset()
    running = envs.save_state()
    idle = np.zeros(envs.action_space.shape, dtype=np.float32)
    assert envs.step(idle)[3].all()
    ended = envs.save_state()
    envs.restore_state(running)
    assert envs.step(idle)[3].all()
    envs.restore_state(ended)
    with pytest.raises(ResetNeeded, match="2 envs have ended"):
        envs.step(idle)


def test_a_state_that_does_not_fit_is_rejected(tmp_path: Path) -> None:
    table = toy(tmp_path)
    envs = dappo_batch.make_vec(table, 2, seed=0, autoreset="same_step")
    with pytest.raises(ConfigError, match="before the first reset"):
        envs.restore_state(envs.save_state())
    envs.reset()
    with pytest.raises(ConfigError, match="takes what save_state returned, got tuple"):
        envs.restore_state(envs.get_state())  # type: ignore[arg-type]
    short = {"seed": 0, "max_episode_steps": 1, "threads": 1}
    waiting = dappo_batch.make_vec(table, 2, autoreset="next_step", **short)
    waiting.reset()
    waiting.step(waiting.action_space.sample())
    with pytest.raises(CheckpointError, match="waits for its reset"):
        envs.restore_state(waiting.save_state())
    more = dappo_batch.make_vec(table, 3, seed=0)
    more.reset()
    with pytest.raises((CheckpointError, dappo_batch.ShapeError)):
        envs.restore_state(more.save_state())


@pytest.mark.parametrize("name", ["filtered servos", "velocities that are not observed"])
def test_twins_in_mid_episode_need_observations_that_determine_the_state(
    name: str, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    robot, run = tmp_path / "tripod.toml", tmp_path / "run"
    if name in HIDDEN:
        old, new, reason = HIDDEN[name]
        toy(tmp_path, old, new)
    else:
        toy(tmp_path)
        reason = "add `qpos` (with `skip` of at most 2) and `qvel`"
        robot.write_text(robot.read_text().replace('{ term = "qvel" }, ', ""))
    train = ["train", "--robot", str(robot), "--run", str(run), "--steps", str(ITERATION)]
    assert run_cli([*train, *TINY]) == 0
    collect = ["diagnose", "collect", str(run), "--rollouts", "2", "--timesteps", "3", "--threads", "1"]
    assert run_cli([*collect, "--preset", "residual", "--out", str(tmp_path / "residual")]) == 1
    assert reason in capfd.readouterr().err
    assert not (tmp_path / "residual").exists()
    assert run_cli([*collect, "--preset", "paper", "--out", str(tmp_path / "paper")]) == 0
