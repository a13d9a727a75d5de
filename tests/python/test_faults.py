"""Faults of sensors and dropouts of actions, recomputed in NumPy from the same episodes without faults."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import pytest

import dappo_batch as db

from ..kernels.philox_numpy import Stream
from .resuming import replayed, trained_twice
from .walker import BACKENDS, DT, SURVIVE, make_walker, observed

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]

SEED, ENVS, STEPS = 5, 24, 40
SENSOR_FAULTS, ACTION_DROPOUT = 20, 21  # purposes of random streams
JOINTS = ("right_knee", "right_hip", "left_hip", "left_knee")
KINDS = ("stuck", "biased", "lost")
TERMS = ("joint_pos", "joint_vel", "base_ang_vel", "projected_gravity", "base_lin_vel")
SENSORS = ", ".join(f'{{ term = "{name}" }}' for name in TERMS)
ENCODER = """
[events.encoder_fault]
share = 0.7
kinds = ["stuck", "biased", "lost"]
joints = ".*knee|left_hip"
offset = [-0.3, 0.4]
onset = [0.0, 0.4]
duration = [0.1, 0.3]
"""
IMU = """
[events.imu_fault]
share = 0.6
kinds = ["lost", "stuck", "biased"]
offset = { base_ang_vel = [-0.5, 0.5], base_lin_vel = [0.1, 0.2] }
onset = [0.0, 0.02]
"""


@dataclass
class Fault:
    """What an episode has drawn for a sensor."""

    kind: str | None
    part: int
    onset: float  # steps
    end: float
    offsets: Array

    def is_active(self, step: int) -> bool:
        return self.kind is not None and self.onset <= step < self.end

    def read(self, truth: Array) -> Array:
        """Return what the sensor reads in all steps, [T, R], given what it should."""
        rows = truth.copy()
        for step in range(len(truth)):
            if self.is_active(step):
                before = truth[max(int(self.onset) - 1, 0)]
                faulty = {"stuck": before, "biased": truth[step] + self.offsets, "lost": 0 * before}
                rows[step] = faulty[str(self.kind)]
        return rows


def draw(
    stream: Stream,
    share: float,
    kinds: tuple[str, ...],
    parts: tuple[int, ...],
    onset: tuple[float, float],
    duration: tuple[float, float] | None,
    offsets: list[tuple[float, float] | None],
) -> Fault:
    """Draw a fault from a stream, in the order of the settings."""

    def within(low: float, high: float) -> float:
        return low + (high - low) * stream.uniform()

    has_it = stream.uniform() < share
    kind, part = kinds[stream.below(len(kinds))], parts[stream.below(len(parts))]
    first = round(within(*onset) / DT)
    end = first + max(round(within(*duration) / DT), 1) if duration else np.inf
    drawn = np.array([within(*offset) if offset else 0.0 for offset in offsets])
    if not has_it:
        return Fault(None, part, 0, 0, 0 * drawn)
    return Fault(kind, part, first, end, drawn * (kind == "biased"))


def drawn_faults(env: int) -> tuple[Fault, Fault]:
    """Return the faults of the encoder and the IMU in the first episode of an env."""
    stream = Stream(SEED + env, 0, SENSOR_FAULTS)
    encoder = draw(stream, 0.7, KINDS, (0, 2, 3), (0.0, 0.4), (0.1, 0.3), [(-0.3, 0.4), None])
    offsets = [(-0.5, 0.5)] * 3 + [None] * 3 + [(0.1, 0.2)] * 3
    imu = draw(stream, 0.6, ("lost", "stuck", "biased"), (0,), (0.0, 0.02), None, offsets)
    return encoder, imu


def run(env: db.DamageVectorEnv, steps: int = STEPS) -> tuple[Array, Array]:
    """Return observations [T, N, O] and events [T, N, E] of an episode with random actions."""
    rng = np.random.default_rng(0)
    obs, infos = env.reset()
    rows, events = [obs], [infos.get("events")]
    for _ in range(steps):
        obs, _, _, _, infos = env.step(rng.uniform(-0.5, 0.5, (env.num_envs, 4)).astype(np.float32))
        rows.append(obs)
        events.append(infos.get("events"))
    env.close()
    return np.array(rows, dtype=np.float64), np.array(events)


def distorted(truth: Array, faults: tuple[Fault, Fault]) -> Array:
    """Return the readings of one env, [T, 17], in the order of `SENSORS`."""
    encoder, imu = faults
    rows = truth.copy()
    columns = [encoder.part, 4 + encoder.part]
    rows[:, columns] = encoder.read(truth[:, columns])
    rows[:, 8:] = imu.read(truth[:, 8:])
    return rows


@pytest.mark.parametrize("backend", BACKENDS)
def test_sensor_faults_distort_what_the_policy_observes_and_nothing_else(
    tmp_path: Path, backend: str
) -> None:
    options: dict[str, Any] = {"num_envs": ENVS, "seed": SEED}
    rewards = "[rewards]\npose_squared = { weight = 1.0 }\n"
    truth, _ = run(make_walker(tmp_path, observed(SENSORS) + rewards, backend, **options))
    env = make_walker(tmp_path, observed(SENSORS) + rewards + ENCODER + IMU, backend, **options)
    shown, _ = run(env)
    seen = set()
    for index in range(ENVS):
        faults = drawn_faults(index)
        seen |= {(fault.kind, fault.onset == 0) for fault in faults}
        expected = distorted(truth[:, index], faults)
        np.testing.assert_allclose(shown[:, index], expected, rtol=1e-6, atol=1e-7)
    # All kinds occur, also from the first observation on.
    assert {(kind, False) for kind in KINDS} < seen
    assert {(kind, True) for kind in KINDS} < seen


def test_infos_hold_what_the_faults_have_drawn_and_whether_they_are_active(tmp_path: Path) -> None:
    env = make_walker(
        tmp_path,
        observed(SENSORS + ', { term = "events" }') + SURVIVE + ENCODER + IMU,
        "lanes",
        num_envs=ENVS,
        seed=SEED,
    )
    names = env.event_names
    axes = [f"{term} {axis}" for term in ("base_ang_vel", "base_lin_vel") for axis in "xyz"]
    encoder = ["active", *KINDS, "right_knee", "left_hip", "left_knee", "offset", "onset", "end"]
    imu = ["active", "lost", "stuck", "biased", *axes, "onset"]
    assert names == [f"encoder_fault {name}" for name in encoder] + [f"imu_fault {name}" for name in imu]
    obs, events = run(env)
    np.testing.assert_array_equal(obs[:, :, 17:], events.astype(np.float32))
    for index in range(ENVS):
        of_encoder, of_imu = drawn_faults(index)
        for step in (0, 5, 13, 20, STEPS):
            values = dict(zip(names, events[step, index], strict=True))
            for sensor, fault in (("encoder_fault", of_encoder), ("imu_fault", of_imu)):
                assert values[f"{sensor} active"] == fault.is_active(step)
                assert [values[f"{sensor} {kind}"] for kind in KINDS] == [
                    fault.kind == kind for kind in KINDS
                ]
                assert values[f"{sensor} onset"] == pytest.approx(fault.onset * DT)
            joints = [values[f"encoder_fault {JOINTS[part]}"] for part in (0, 2, 3)]
            assert joints == [of_encoder.kind is not None and of_encoder.part == part for part in (0, 2, 3)]
            assert values["encoder_fault offset"] == pytest.approx(of_encoder.offsets[0])
            assert values["encoder_fault end"] == pytest.approx(of_encoder.end * DT)
            offsets = [values[f"imu_fault {axis}"] for axis in axes]
            np.testing.assert_allclose(offsets, of_imu.offsets[[0, 1, 2, 6, 7, 8]], rtol=1e-12)


def test_the_modifiers_of_a_term_apply_to_the_faulty_reading(tmp_path: Path) -> None:
    options: dict[str, Any] = {"num_envs": ENVS, "seed": SEED}
    truth, _ = run(make_walker(tmp_path, observed(SENSORS) + SURVIVE, "lanes", **options))
    faults = ENCODER.replace('"stuck", "biased", "lost"', '"biased"').replace("0.7", "1.0")
    terms = '{ term = "joint_pos", clip = 0.3, scale = 2.0, delay = 1, history = 2 }'
    chained, _ = run(make_walker(tmp_path, observed(terms) + SURVIVE + faults, "lanes", **options))
    terms = '{ term = "joint_pos", noise = 0.05 }'
    noisy, _ = run(make_walker(tmp_path, observed(terms) + SURVIVE + faults, "lanes", **options))
    for index in range(ENVS):
        stream = Stream(SEED + index, 0, SENSOR_FAULTS)
        fault = draw(stream, 1.0, ("biased",), (0, 2, 3), (0.0, 0.4), (0.1, 0.3), [(-0.3, 0.4), None])
        read = truth[:, index, :4].copy()
        read[:, [fault.part]] = fault.read(read[:, [fault.part]].repeat(2, axis=1))[:, :1]
        frames = 2.0 * np.clip(read, -0.3, 0.3)
        for step in range(STEPS + 1):
            expected = [frames[max(step - 2, 0)], frames[max(step - 1, 0)]]
            np.testing.assert_allclose(chained[step, index], np.concatenate(expected), rtol=1e-5, atol=1e-6)
        errors = noisy[:, index] - read
        assert 0.04 < np.abs(errors).max() <= 0.05 + 1e-6


DROPOUT = """
[events]
action_delay = { steps = [0, 2] }
encoder_bias = { offset = [-0.1, 0.1] }
action_dropout = { share = 0.7, every = [0.04, 0.2], duration = [0.02, 0.1] }
"""


def dropouts(env: int, steps: int) -> list[tuple[int, int]]:
    """Return first step and end of the dropouts of an env's first episode, up to that after these steps."""
    spans: list[tuple[int, int]] = []

    def draw(stream: Stream, step: int) -> tuple[int, int]:
        first = step + max(round((0.04 + 0.16 * stream.uniform()) / DT), 1)
        return first, first + max(round((0.02 + 0.08 * stream.uniform()) / DT), 1)

    stream = Stream(SEED + env, 0, ACTION_DROPOUT)
    if stream.uniform() < 0.7:
        spans.append(draw(stream, 0))
        while spans[-1][1] <= steps:
            end = spans[-1][1]
            spans.append(draw(Stream(SEED + env, end, ACTION_DROPOUT), end))
    return spans


def test_in_a_dropout_the_last_control_is_held_on_both_backends(tmp_path: Path) -> None:
    task = observed('{ term = "last_action" }') + SURVIVE + DROPOUT
    options: dict[str, Any] = {"num_envs": ENVS, "seed": SEED, "damage": "healthy"}
    envs = {name: make_walker(tmp_path, task, name, **options) for name in BACKENDS}
    infos = {name: env.reset()[1] for name, env in envs.items()}
    names = envs["mujoco"].event_names
    assert names[-3:] == ["action_dropout active", "action_dropout onset", "action_dropout end"]
    model = envs["mujoco"].table.models[0]
    home, scale = model.key("home").qpos, np.array([0.25, 0.5, 0.5, 0.25])
    addresses = [model.joint(name).qposadr[0] for name in JOINTS]
    data = [mujoco.MjData(model) for _ in range(ENVS)]
    for world, qpos, qvel in zip(data, *envs["mujoco"].get_state(), strict=True):
        world.qpos, world.qvel = qpos, qvel
    held, lost, sent = np.zeros((ENVS, 4)), 0, []
    rng = np.random.default_rng(3)
    for step in range(STEPS):
        events = infos["mujoco"]["events"]
        np.testing.assert_array_equal(infos["lanes"]["events"], events)
        action = rng.uniform(-1, 1, (ENVS, 4)).astype(np.float32)
        sent.append(action.astype(np.float64))
        for index, world in enumerate(data):
            spans = dropouts(index, step)
            is_lost = any(first <= step < end for first, end in spans)
            shown = (float(is_lost), *(DT * steps for steps in spans[-1])) if spans else (0, 0, 0)
            assert tuple(events[index, -3:]) == pytest.approx(shown)
            delay = int(events[index, 4])
            arrived = sent[-1 - delay][index] if delay < len(sent) else np.zeros(4)
            held[index] = held[index] if is_lost else arrived
            lost += is_lost
            world.ctrl = home[addresses] + scale * held[index] - events[index, :4]
            mujoco.mj_step(model, world, nstep=5)
        for name, env in envs.items():
            obs, _, _, _, infos[name] = env.step(action)
            np.testing.assert_array_equal(obs, action)  # what the policy sent
            tolerance = 1e-9 if name == "mujoco" else 1e-6
            for got, field in zip(env.get_state(), ("qpos", "qvel"), strict=True):
                expected = [getattr(world, field) for world in data]
                np.testing.assert_allclose(got, expected, rtol=tolerance, atol=tolerance)
    assert lost > ENVS
    for env in envs.values():
        env.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_results_are_the_same_for_any_threads_and_after_a_saved_state(tmp_path: Path, backend: str) -> None:
    task = observed(SENSORS + ', { term = "events" }') + SURVIVE + DROPOUT + ENCODER + IMU
    options: dict[str, Any] = {
        "num_envs": ENVS,
        "seed": SEED,
        "autoreset": "same_step",
        "max_episode_steps": 15,
    }
    one = make_walker(tmp_path, task, backend, threads=1, **options)
    two = make_walker(tmp_path, task, backend, threads=2, **options)
    for rows in zip(run(one), run(two), strict=True):
        np.testing.assert_array_equal(*rows)
    env = make_walker(tmp_path, task, backend, **options)
    env.reset()
    actions = np.random.default_rng(1).uniform(-1, 1, (30, ENVS, 4)).astype(np.float32)
    for action in actions[:10]:
        env.step(action)
    replayed(env, actions[10:], lambda step: [step[0], step[4]["events"]])
    env.close()


@pytest.mark.parametrize(
    ("task", "error"),
    [
        (ENCODER.replace('".*knee|left_hip"', '"tail"'), 'no actuated joint has a name that matches "tail"'),
        (ENCODER.replace('".*knee|left_hip"', '"("'), "`joints`: .* is not a regular expression"),
        (
            ENCODER.replace('"lost"]', '"gone"]'),
            '`kinds` has "gone" in it, expected some of stuck, biased, lost',
        ),
        (ENCODER.replace('"lost"]', '"stuck"]'), '`kinds` has "stuck" in it twice'),
        (
            ENCODER.replace("offset = [-0.3, 0.4]", ""),
            r"\[events.encoder_fault\]: the entry `offset` is missing",
        ),
        (ENCODER.replace("[0.1, 0.3]", "[0.3, 0.1]"), "`duration` is a list, expected"),
        (ENCODER.replace("0.7", "1.7"), "`share` is 1.7, expected a number from 0 to 1"),
        (IMU.replace("base_ang_vel", "qvel"), r"\[events.imu_fault.offset\]: unknown entries qvel"),
        (IMU.replace("onset", "start"), "the entry `onset` is missing"),
        ("[events]\naction_dropout = { share = 0.5, every = [1, 2] }\n", "the entry `duration` is missing"),
    ],
)
def test_wrong_entries_are_refused_by_name(tmp_path: Path, task: str, error: str) -> None:
    with pytest.raises(db.ConfigError, match=error):
        make_walker(tmp_path, observed(SENSORS) + SURVIVE + task, "lanes")


def test_a_fault_of_a_sensor_that_the_policy_does_not_observe_is_refused(tmp_path: Path) -> None:
    for fault, error in (
        (ENCODER, r"\[events.encoder_fault\] needs `joint_pos` or `joint_vel` in \[observation.policy\]"),
        (IMU, r"\[events.imu_fault\] needs `base_ang_vel`, `projected_gravity` or `base_lin_vel`"),
    ):
        with pytest.raises(db.ConfigError, match=error):
            make_walker(tmp_path, observed('{ term = "base_height" }') + SURVIVE + fault, "lanes")


def test_a_training_with_faults_resumes_exactly(tmp_path: Path) -> None:
    critic = f'[observation.critic]\nterms = [{SENSORS}, {{ term = "events" }}]\n'
    make_walker(tmp_path, observed(SENSORS) + critic + SURVIVE + DROPOUT + ENCODER + IMU, "lanes").close()
    trained_twice(tmp_path, str(tmp_path / "walker.toml"), iterations=4)
