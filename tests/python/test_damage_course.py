"""Damage that ends and returns, compared with draws from its random stream and with plain MuJoCo."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import gymnasium
import mujoco
import numpy as np
import pytest

import dappo_batch as db
from dappo_batch import ClassTable

from ..kernels.philox_numpy import Stream
from .command_line import TINY, dappo_batch
from .resuming import replayed, trained_twice

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

SEED, ENVS, STEPS = 11, 16, 30
DAMAGE_CLASS, ONSET, DAMAGE_DURATION, CODE_DELAY = 1, 2, 22, 26  # purposes of random streams
COURSE: dict[str, Any] = {"onset": (2, 6), "damage_duration": (1, 7), "damage_pause": (2, 4)}


def classes(table: ClassTable, **options: Any) -> NDArray[np.int64]:  # noqa: ANN401
    """Return the damage classes of all steps of an episode, [T, N], the one at the reset first."""
    options = {"num_envs": ENVS, "seed": SEED, "damage": "jammed_joint@1"} | options
    envs = db.make_vec(table, **options)
    rows = [envs.reset()[1]["damage_class"]]
    for _ in range(STEPS):
        *_, infos = envs.step(np.zeros(envs.action_space.shape, dtype=np.float32))
        rows.append(infos["damage_class"])
    envs.close()
    return np.array(rows)


def expected(env: int, damage: int, *, returns: bool) -> list[int]:
    """Return the class of every step of the first episode of an env, from its random streams."""
    onset = 2 + Stream(SEED + env, 0, ONSET).below(5)
    stream = Stream(SEED + env, 0, DAMAGE_DURATION)
    duration, pause = 1 + stream.below(7), 2 + stream.below(3)
    # The class of a step is that which acted in it; at the reset it is that of the first step.
    times = [step - onset for step in (0, *range(STEPS))]
    phases = [since % (duration + pause) if returns else since for since in times]
    return [damage * (since >= 0 and phase < duration) for since, phase in zip(times, phases, strict=True)]


@pytest.mark.parametrize("returns", [True, False])
def test_damage_lasts_and_pauses_as_drawn_for_any_threads(
    ant_table: ClassTable, backend: str, returns: bool
) -> None:
    course = COURSE if returns else {key: COURSE[key] for key in ("onset", "damage_duration")}
    damage = ant_table.space.parse("jammed_joint@1")
    one, two = (classes(ant_table, backend=backend, threads=threads, **course) for threads in (1, 2))
    np.testing.assert_array_equal(one, two)
    for env in range(ENVS):
        assert one[:, env].tolist() == expected(env, damage, returns=returns)


@pytest.mark.parametrize("onset", [0, (2, 6)])
def test_codes_are_late_as_drawn_and_classes_are_not(
    ant_table: ClassTable, backend: str, onset: int | tuple[int, int]
) -> None:
    options: dict[str, Any] = {
        "backend": backend,
        "seed": SEED,
        "damage": "jammed_joint@1",
        "code_delay": (0, 5),
    }
    envs = db.make_vec(ant_table, ENVS, onset=onset, damage_duration=(3, 9), **options)
    obs, infos = envs.reset()
    seen = [(obs[:, -8:], infos["damage_class"])]
    for _ in range(STEPS):
        obs, _, terminated, _, infos = envs.step(np.zeros(envs.action_space.shape, dtype=np.float32))
        assert not terminated.any()
        seen.append((obs[:, -8:], infos["damage_class"]))
    envs.close()
    code_of = np.array([item.code for item in ant_table.space.classes])
    delays = [Stream(SEED + env, 0, CODE_DELAY).below(6) for env in range(ENVS)]
    assert set(delays) == {0, 1, 2, 3, 4, 5}
    for env, delay in enumerate(delays):
        classes = [int(damage[env]) for _, damage in seen]
        # The class at the reset is that of the first step.
        acted = (
            [classes[0], *classes[1:]]
            if delay == 0
            else [0] * (delay + 1) + classes[1 : len(classes) - delay]
        )
        np.testing.assert_array_equal([code[env] for code, _ in seen], code_of[acted])
        assert len(set(classes)) == 2


@pytest.mark.parametrize(("min_class_steps", "episodes"), [(0, 1), (4, 1), (5, 2), (8, 2), (9, 3)])
def test_an_env_keeps_its_class_for_the_least_steps(
    ant_table: ClassTable, min_class_steps: int, episodes: int
) -> None:
    envs = db.make_vec(
        ant_table,
        ENVS,
        seed=SEED,
        max_episode_steps=4,
        min_class_steps=min_class_steps,
        autoreset="same_step",
    )
    drawn = [envs.reset()[1]["damage_class"]]
    for step in range(1, 6 * 4):
        *_, infos = envs.step(np.zeros(envs.action_space.shape, dtype=np.float32))
        if step % 4 == 0:
            drawn.append(infos["damage_class"])
    envs.close()
    count = len(ant_table.space)
    for env in range(ENVS):
        uniform = [Stream(SEED + env, number, DAMAGE_CLASS).uniform() for number in range(6)]
        of_episode = [int(count * uniform[number - number % episodes]) for number in range(6)]
        assert [int(row[env]) for row in drawn] == of_episode


def test_a_robot_recovers_as_one_that_continues_with_the_healthy_model(
    ant_table: ClassTable, backend: str
) -> None:
    options: dict[str, Any] = {"backend": backend, "precision": "f64", "seed": 3, "reward": "gym"}
    envs = db.make_vec(
        ant_table, 1, damage="missing_toe@0", onset=4, damage_duration=5, damage_pause=3, **options
    )
    obs, _ = envs.reset()
    code = obs[0, -8:]
    data = mujoco.MjData(ant_table.models[0])
    data.qpos, data.qvel = (state[0] for state in envs.get_state())
    rng = np.random.default_rng(2)
    # Steps 4 to 8 and 12 to 16 are damaged.
    damaged = [4, 5, 6, 7, 8, 12, 13, 14, 15, 16]
    index = ant_table.space.parse("missing_toe@0")
    for step in range(18):
        action = rng.uniform(-1, 1, (1, 8)).astype(np.float32)
        model = ant_table.models[index if step in damaged else 0]
        data.ctrl = action[0]
        mujoco.mj_step(model, data, nstep=5)
        obs, _, terminated, _, infos = envs.step(action)
        assert not terminated[0]
        assert infos["damage_class"][0] == (index if step in damaged else 0)
        code = obs[0, -8:]
        np.testing.assert_array_equal(code, ant_table.space.classes[infos["damage_class"][0]].code)
        tolerance = 1e-12 if backend == "mujoco" else 1e-6
        np.testing.assert_allclose(envs.get_state()[0][0], data.qpos, rtol=tolerance, atol=tolerance)
    envs.close()


def test_a_reset_fixes_duration_and_pause_of_each_env(ant_table: ClassTable) -> None:
    envs = db.make_vec(ant_table, 3, seed=0, damage="healthy", onset=9, damage_duration=(1, 4))
    fixed = {"damage_class": 5, "onset": 2, "damage_duration": [3, 0, 1], "damage_pause": [0, 4, 2]}
    rows = [envs.reset(options=fixed)[1]["damage_class"]]
    for _ in range(9):
        rows.append(envs.step(np.zeros((3, 8)))[4]["damage_class"])  # noqa: PERF401
    active = np.array(rows[1:]) == 5
    assert active.T.tolist() == [
        [step in (2, 3, 4) for step in range(9)],
        [step >= 2 for step in range(9)],  # 0: for good
        [step in (2, 5, 8) for step in range(9)],
    ]
    envs.close()
    robot = gymnasium.make("dappo_batch/Ant-v0", disable_env_checker=True, damage_duration=2).unwrapped
    robot.reset(options={"damage_class": 5, "onset": 1})
    seen = [robot.step(np.zeros(8))[4]["damage_class"] for _ in range(5)]
    assert seen == [0, 5, 5, 0, 0]
    robot.reset(options={"damage_class": 5, "damage_duration": 1, "damage_pause": 1})
    assert [robot.step(np.zeros(8))[4]["damage_class"] for _ in range(4)] == [5, 0, 5, 0]
    robot.close()


def test_a_saved_state_and_the_next_episodes_keep_the_course(ant_table: ClassTable, backend: str) -> None:
    envs = db.make_vec(
        ant_table,
        8,
        seed=4,
        backend=backend,
        max_episode_steps=12,
        min_class_steps=20,
        code_delay=(0, 3),
        **COURSE,
    )
    actions = np.random.default_rng(0).uniform(-1, 1, (40, 8, 8)).astype(np.float32)
    envs.reset()
    for action in actions[:7]:
        envs.step(action)
    steps = replayed(envs, actions[7:], lambda step: [step[0], step[4]["damage_class"]])
    assert len(np.unique([damage for _, damage in steps])) > 4
    envs.close()


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"damage_pause": 3}, "damage that stays does not return"),
        ({"damage_duration": 0}, "damage_duration .*1"),
        ({"damage_duration": (5, 2)}, "damage_duration: the range must not be empty"),
        ({"damage_duration": 2, "damage_pause": (0, 3)}, "damage_pause .*1"),
        ({"damage_duration": "long"}, "damage_duration"),
        ({"min_class_steps": -1}, "min_class_steps .*0"),
        ({"code_delay": -1}, "code_delay .*0"),
        ({"code_delay": (5, 2)}, "code_delay: the range must not be empty"),
    ],
)
def test_wrong_durations_are_refused(ant_table: ClassTable, options: dict[str, Any], error: str) -> None:
    with pytest.raises(db.ConfigError, match=error):
        db.make_vec(ant_table, 1, **options)


def test_a_training_with_damage_that_returns_resumes_exactly_and_is_evaluated_with_it(tmp_path: Path) -> None:
    course = {"damage.onset": {"first": 1, "last": 5}, "damage.duration": {"first": 2, "last": 9}}
    course |= {"damage.pause": {"first": 1, "last": 4}, "damage.code_delay": {"first": 0, "last": 3}}
    course |= {"env.max_episode_steps": 25, "damage.max_damaged_limbs": 1, "damage.min_class_steps": 60}
    whole = trained_twice(tmp_path, "ant", iterations=4, **course)
    ends = (whole.path / "eval" / "per_class.csv").read_text()
    course |= {"damage.duration": {"first": 1, "last": 1}, "damage.pause": {"first": 9, "last": 9}}
    other = trained_twice(tmp_path / "other", "ant", iterations=2, **course)
    assert (other.path / "eval" / "per_class.csv").read_text() != ends
    with pytest.raises(db.DappoError, match=r"its `damage.duration` is `1 to 1`, expected `2 to 9`"):
        db.evaluate(whole.path, compare=[other.path])


def test_a_configuration_with_a_pause_alone_is_refused(tmp_path: Path) -> None:
    for setting, fault in (
        ("damage.pause={ first = 1, last = 2 }", "`damage.pause` is set, but `damage.duration` is not"),
        (
            "damage.duration={ first = 0, last = 2 }",
            "`damage.duration` is 0 to 2, expected a range in ascending order",
        ),
        ("damage.code_delay={ first = 4, last = 2 }", "`damage.code_delay` is 4 to 2, expected a range in"),
    ):
        _, error = dappo_batch("train", *TINY, setting, "--run", tmp_path / "run", code=1)
        assert fault in error
