"""Terms of observations and rewards, commands, actions and events, against MuJoCo and NumPy."""

from __future__ import annotations

import copy
import json
import sys
import tomllib
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np
import pytest

import dappo_batch as db

from .resuming import replayed, trained_twice
from .walker import BACKENDS, DT, ENVS, SURVIVE, make_walker, observed

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    Make = Callable[..., db.DamageVectorEnv]

OBSERVATIONS = {
    "base_height": 1,
    "base_lin_vel": 3,
    "base_ang_vel": 3,
    "projected_gravity": 3,
    "command": 3,
    "joint_pos": 4,
    "joint_vel": 4,
    "last_action": 4,
    "clock": 2,
    "foot_contact": 2,
    "foot_vel": 6,
    "foot_height": 2,
    "foot_air_time": 2,
}

REWARDS = """
[rewards]
track_lin_vel = { weight = 2.0, std = 0.5 }
track_ang_vel = { weight = 1.0, std = 0.4 }
upright = { weight = 1.0, std = 0.3 }
tilt_squared = { weight = -1.0 }
lin_vel_z_squared = { weight = -2.0 }
ang_vel_xy_squared = { weight = -0.5 }
base_height_squared = { weight = -3.0, target = 0.3 }
action_rate_squared = { weight = -0.1 }
torque_squared = { weight = -0.01 }
power = { weight = -0.02 }
joint_limits = { weight = -1.0, soft = 0.2 }
pose_squared = { weight = -0.5 }
pose = { weight = 1.0, std = 0.5 }
stand_still = { weight = -1.0 }
feet_air_time = { weight = 1.0, threshold = 0.05 }
feet_slip = { weight = -0.3 }
feet_clearance = { weight = -0.2, target = 0.1 }
landing = { weight = -0.01 }
survive = { weight = 0.25 }
"""


@pytest.fixture
def make(tmp_path: Path) -> Make:
    """Make vector envs of the robot with a task."""

    def make(task: str, backend: str, **options: Any) -> db.DamageVectorEnv:  # noqa: ANN401
        return make_walker(tmp_path, task, backend, **options)

    return make


ALL_TERMS = observed(
    ", ".join(f'{{ term = "{name}"{", period = 0.7" * (name == "clock")} }}' for name in OBSERVATIONS)
)


def blocks(obs: Array) -> dict[str, Array]:
    ends = np.cumsum(list(OBSERVATIONS.values()))
    return dict(zip(OBSERVATIONS, np.split(obs, ends[:-1], axis=-1), strict=True))


def data_of(model: mujoco.MjModel, qpos: Array, qvel: Array) -> mujoco.MjData:
    data = mujoco.MjData(model)
    data.qpos, data.qvel = qpos, qvel
    mujoco.mj_forward(model, data)
    return data


def foot_motion(model: mujoco.MjModel, data: mujoco.MjData) -> tuple[Array, Array]:
    """Return positions and velocities of the two feet from MuJoCo's kinematics."""
    jacobian = np.zeros((3, model.nv))
    positions, velocities = [], []
    for point, body in (
        (data.geom("left_foot").xpos, model.body("left_shank").id),
        (data.site("right_toe").xpos, model.body("right_end").id),
    ):
        mujoco.mj_jac(model, data, jacobian, None, point, body)
        positions.append(point.copy())
        velocities.append(jacobian @ data.qvel)
    return np.array(positions), np.array(velocities)


@pytest.mark.parametrize("backend", BACKENDS)
def test_observations_equal_mujocos_kinematics(make: Make, backend: str) -> None:
    env = make(ALL_TERMS + SURVIVE, backend)
    model, home = env.table.models[0], env.table.models[0].key("home").qpos
    order = [model.joint(name).qposadr[0] for name in ("right_knee", "right_hip", "left_hip", "left_knee")]
    obs, _ = env.reset()
    rng = np.random.default_rng(0)
    action = np.zeros((ENVS, 4), dtype=np.float32)
    for step in range(12):
        qpos, qvel = env.get_state()
        for index in range(ENVS):
            got = blocks(obs[index].astype(np.float64))
            data = data_of(model, qpos[index], qvel[index])
            rotation = data.body("trunk").xmat.reshape(3, 3)
            positions, velocities = foot_motion(model, data)
            expected = {
                "base_height": qpos[index, 2:3],
                "base_lin_vel": rotation.T @ qvel[index, :3],
                "base_ang_vel": qvel[index, 3:6],
                "projected_gravity": rotation.T @ [0.0, 0.0, -1.0],
                "joint_pos": qpos[index, order] - home[order],
                "joint_vel": qvel[index, np.array(order) - 1],
                "last_action": np.clip(action[index], -1, 1),
                "clock": [np.sin(2 * np.pi * step * DT / 0.7), np.cos(2 * np.pi * step * DT / 0.7)],
                "foot_vel": velocities.ravel(),
                "foot_height": positions[:, 2],
            }
            for name, value in expected.items():
                np.testing.assert_allclose(got[name], value, rtol=1e-5, atol=2e-6, err_msg=name)
        action = rng.normal(size=(ENVS, 4)).astype(np.float32)
        obs, *_ = env.step(action)
    env.close()


def expected_rewards(
    model: mujoco.MjModel, before: dict[str, Array], after: dict[str, Array], home: Array
) -> dict[str, float]:
    """Return the weighted terms of `REWARDS` from the states around an env step, by their formulas."""
    names = ("right_knee", "right_hip", "left_hip", "left_knee")
    addresses = np.array([model.joint(name).qposadr[0] for name in names])
    data = data_of(model, after["qpos"], after["qvel"])
    rotation = data.body("trunk").xmat.reshape(3, 3)
    velocity, spin = rotation.T @ after["qvel"][:3], after["qvel"][3:6]
    gravity = rotation.T @ [0.0, 0.0, -1.0]
    command = before["command"]
    standing = np.linalg.norm(command) <= 0.1
    deviation = after["qpos"][addresses] - home[addresses]
    ranges = np.array([model.joint(name).range for name in names])
    middle, half = ranges.mean(axis=1), 0.2 * (ranges[:, 1] - ranges[:, 0]) / 2
    positions, velocities = foot_motion(model, data)
    speed = np.linalg.norm(velocities[:, :2], axis=1)
    contact, landed, air = after["force"] > 1.0, after["landed"], before["air_time"]
    force = after["actuator_force"]
    return {
        "track_lin_vel": 2.0 * np.exp(-np.sum((velocity[:2] - command[:2]) ** 2) / 0.5**2),
        "track_ang_vel": np.exp(-((spin[2] - command[2]) ** 2) / 0.4**2),
        "upright": np.exp(-np.sum(gravity[:2] ** 2) / 0.3**2),
        "tilt_squared": -np.sum(gravity[:2] ** 2),
        "lin_vel_z_squared": -2.0 * velocity[2] ** 2,
        "ang_vel_xy_squared": -0.5 * np.sum(spin[:2] ** 2),
        "base_height_squared": -3.0 * (after["qpos"][2] - 0.3) ** 2,
        "action_rate_squared": -0.1 * np.sum((after["action"] - before["action"]) ** 2),
        "torque_squared": -0.01 * np.sum(force**2),
        "power": -0.02 * np.sum(np.abs(force * after["qvel"][addresses - 1])),
        "joint_limits": -np.sum(np.maximum(np.abs(after["qpos"][addresses] - middle) - half, 0.0)),
        "pose_squared": -0.5 * np.sum(deviation**2),
        "pose": np.exp(-np.mean(deviation**2) / 0.5**2),
        "stand_still": -float(standing) * np.sum(np.abs(deviation)),
        "feet_air_time": float(not standing) * np.sum((air - 0.05)[landed]),
        "feet_slip": -0.3 * np.sum(speed[contact] ** 2),
        "feet_clearance": -0.2 * np.sum(np.abs(positions[:, 2] - 0.1) * speed),
        "landing": -0.01 * np.sum(after["force"][landed]),
        "survive": 0.25,
    }


@pytest.mark.parametrize("backend", BACKENDS)
def test_rewards_equal_their_formulas_on_mujocos_own_steps(make: Make, backend: str) -> None:
    env = make(ALL_TERMS + REWARDS, backend)
    names = env.reward_names
    assert names == sorted(tomllib.loads(REWARDS)["rewards"])
    model = env.table.models[0]
    home = model.key("home").qpos
    feet = [model.body("left_shank").id, model.body("right_end").id]
    obs, _ = env.reset()
    data = [mujoco.MjData(model) for _ in range(ENVS)]
    for index, (qpos, qvel) in enumerate(zip(*env.get_state(), strict=True)):
        data[index].qpos, data[index].qvel = qpos, qvel
    rng = np.random.default_rng(1)
    last, air = np.zeros((ENVS, 4)), np.zeros((ENVS, 2))
    seen = dict.fromkeys(names, 0.0)
    scale = np.array([0.25, 0.5, 0.5, 0.25])
    addresses = [
        model.joint(name).qposadr[0] for name in ("right_knee", "right_hip", "left_hip", "left_knee")
    ]
    for _ in range(60):
        commands = [blocks(row.astype(np.float64))["command"] for row in obs]
        action = np.clip(rng.normal(size=(ENVS, 4)), -1, 1).astype(np.float32)
        obs, rewards, terminated, *_ = env.step(action)
        assert not terminated.any()
        for index in range(ENVS):
            world = data[index]
            world.ctrl = home[addresses] + scale * action[index]
            mujoco.mj_step(model, world, nstep=5)
            mujoco.mj_rnePostConstraint(model, world)
            force = np.linalg.norm(world.cfrc_ext[feet, 3:], axis=1)
            landed = (force > 1.0) & (air[index] > 0)
            expected = expected_rewards(
                model,
                {"command": commands[index], "air_time": air[index], "action": last[index]},
                {
                    "qpos": world.qpos.copy(),
                    "qvel": world.qvel.copy(),
                    "action": action[index],
                    "force": force,
                    "landed": landed,
                    "actuator_force": world.actuator_force.copy(),
                },
                home,
            )
            got = dict(zip(names, env.reward_terms[index], strict=True))
            for name, value in expected.items():
                # Commands are observed in single precision.
                assert got[name] == pytest.approx(value, rel=1e-5, abs=1e-6), name
                seen[name] = max(seen[name], abs(value))
            assert rewards[index] == pytest.approx(sum(expected.values()), rel=1e-5, abs=1e-5)
            air[index] = np.where(force > 1.0, 0.0, air[index] + DT)
            got_blocks = blocks(obs[index].astype(np.float64))
            np.testing.assert_array_equal(got_blocks["foot_contact"], force > 1.0)
            np.testing.assert_allclose(got_blocks["foot_air_time"], air[index], atol=1e-6)
            last[index] = action[index]
    assert min(seen.values()) > 0, seen
    env.close()


def test_noise_clip_scale_delay_and_history_apply_in_this_order(make: Make) -> None:
    plain = make(observed('{ term = "joint_vel" }') + SURVIVE, "mujoco")
    chained = make(
        observed('{ term = "joint_vel", clip = 2.0, scale = 0.5, delay = 2, history = 3 }') + SURVIVE,
        "mujoco",
    )
    noisy = make(observed('{ term = "joint_vel", noise = 0.25 }') + SURVIVE, "mujoco", num_envs=ENVS)
    rng = np.random.default_rng(2)
    values, chain, noise = [], [], []
    for env, shown in ((plain, values), (chained, chain), (noisy, noise)):
        rng = np.random.default_rng(2)
        shown.append(env.reset()[0])
        for _ in range(40):
            shown.append(env.step(rng.uniform(-1, 1, (ENVS, 4)))[0])
        env.close()
    prepared = [0.5 * np.clip(value, -2.0, 2.0) for value in values]
    assert any((np.abs(value) > 2.0).any() for value in values)
    for step, row in enumerate(chain):
        frames = [prepared[max(step - 2 - age, 0)] for age in (2, 1, 0)]
        np.testing.assert_allclose(row, np.concatenate(frames, axis=1), rtol=1e-6)
    errors = np.array(noise) - np.array(values)
    assert np.abs(errors).max() <= 0.25 + 1e-6
    # The standard deviation of a uniform distribution of this width; 492 numbers give it to 3 %.
    assert errors.std() == pytest.approx(0.25 / np.sqrt(3), rel=0.1)
    assert len(np.unique(errors.round(9))) > 480


def test_commands_are_drawn_from_their_ranges_and_held_for_their_time(make: Make) -> None:
    envs, steps = 64, 200
    env = make(observed('{ term = "command" }') + SURVIVE, "lanes", num_envs=envs)
    rows = [env.reset()[0]]
    ends = np.zeros(envs, dtype=bool)
    for _ in range(steps):
        obs, _, terminated, truncated, _ = env.step(np.zeros((envs, 4)))
        ends |= terminated | truncated
        rows.append(obs)
    env.close()
    commands = np.array(rows)
    assert not ends.any()
    changes = np.diff(commands, axis=0).any(axis=2)
    drawn = [commands[0], *(commands[step + 1][row] for step, row in enumerate(changes))]
    drawn = np.concatenate(drawn)
    standing = ~drawn.any(axis=1)
    # Two commands to stand that follow one another look like one, which makes the share a little smaller.
    assert standing.mean() == pytest.approx(0.2 * 0.8, abs=0.04)
    for column, bound in enumerate((1.0, 0.5, 1.0)):
        moving = drawn[~standing][:, column]
        assert np.abs(moving).max() <= bound
        assert moving.std() == pytest.approx(2 * bound / np.sqrt(12), rel=0.1)
    lengths = [np.diff(np.flatnonzero(column)) for column in changes.T]
    # 0.1 to 0.3 s are 5 to 15 steps.
    assert min(length.min() for length in lengths) == 5


def test_an_episode_fails_when_the_robot_tilts_or_a_body_touches(make: Make) -> None:
    tilt = make(ALL_TERMS + SURVIVE + "[terminations]\ntilt = { angle = 0.4 }\n", "lanes", num_envs=1)
    tilt.reset()
    for _ in range(300):
        obs, _, terminated, *_ = tilt.step(np.ones((1, 4)))
        gravity = blocks(obs[0].astype(np.float64))["projected_gravity"]
        assert terminated[0] == (-gravity[2] < np.cos(0.4))
        if terminated[0]:
            break
    assert terminated[0]
    tilt.close()
    limit = '[terminations]\ncontact = { bodies = ["trunk"], force = 2.0 }\n'
    touch = make(ALL_TERMS + SURVIVE + limit, "mujoco", num_envs=1)
    model = touch.table.models[0]
    touch.reset()
    for _ in range(300):
        _, _, terminated, *_ = touch.step(np.ones((1, 4)))
        data = data_of(model, *(state[0] for state in touch.get_state()))
        # The lowest corner of the trunk.
        lowest = data.geom(1).xpos[2] - np.abs(data.geom(1).xmat.reshape(3, 3)[2]) @ model.geom(1).size
        assert lowest < 0.02 if terminated[0] else lowest > -0.02
        if terminated[0]:
            break
    assert terminated[0]
    touch.close()
    with pytest.raises(db.ConfigError, match="no body `tail`"):
        make(ALL_TERMS + SURVIVE + '[terminations]\ncontact = { bodies = ["tail"] }\n', "mujoco")


EVENTS = """
[events]
friction = { scale = [0.4, 1.6] }
motor_strength = { scale = [0.6, 1.4] }
kp = { scale = [0.7, 1.3] }
kd = { scale = [0.5, 2.0] }
joint_damping = { scale = [0.5, 2.0] }
joint_armature = { scale = [0.5, 2.0] }
encoder_bias = { offset = [-0.1, 0.1] }
action_delay = { steps = [0, 3] }
gravity = { angle = [0.0, 0.3] }
push = { every = [0.1, 0.4], lin_vel = 0.5, ang_vel = 1.0 }
"""


def test_events_change_the_physics_as_an_edited_model_does_on_both_backends(make: Make) -> None:
    envs = {
        name: make(observed('{ term = "qpos" }, { term = "events" }') + SURVIVE + EVENTS, name)
        for name in BACKENDS
    }
    shown = {name: env.reset()[0].astype(np.float64) for name, env in envs.items()}
    np.testing.assert_allclose(shown["lanes"], shown["mujoco"], rtol=1e-6, atol=1e-9)
    table = envs["mujoco"].table
    nq = table.models[0].nq
    events = shown["mujoco"][:, nq:]
    assert events.shape == (ENVS, 9 + 4 + 1)
    pushes = 0
    rng = np.random.default_rng(3)
    home = table.models[0].key("home").qpos
    names = ("right_knee", "right_hip", "left_hip", "left_knee")
    addresses = [table.models[0].joint(name).qposadr[0] for name in names]
    scale = np.array([0.25, 0.5, 0.5, 0.25])
    models = [edited(table.models[0], row) for row in events]
    data = [mujoco.MjData(model) for model in models]
    for index, (qpos, qvel) in enumerate(zip(*envs["mujoco"].get_state(), strict=True)):
        data[index].qpos, data[index].qvel = qpos, qvel
    sent: list[Array] = []
    for _ in range(30):
        action = rng.uniform(-1, 1, (ENVS, 4)).astype(np.float32)
        sent.append(action.astype(np.float64))
        for env in envs.values():
            env.step(action)
        states = {name: env.get_state() for name, env in envs.items()}
        for one, other in zip(states["lanes"], states["mujoco"], strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-7)
        for index, world in enumerate(data):
            delay = int(events[index, 13])
            arrived = sent[-1 - delay][index] if delay < len(sent) else np.zeros(4)
            world.ctrl = home[addresses] + scale * arrived - events[index, 9:13]
            mujoco.mj_step(models[index], world, nstep=5)
            got = np.concatenate([state[index] for state in states["mujoco"]])
            expected = np.concatenate([world.qpos, world.qvel])
            # Only a push makes a difference; the world goes along with it.
            pushes += not np.allclose(got, expected, rtol=1e-5, atol=1e-5)
            world.qpos, world.qvel = states["mujoco"][0][index], states["mujoco"][1][index]
    # Every 5 to 20 of 30 steps in 3 envs.
    assert ENVS * (30 // 20) <= pushes <= ENVS * (30 // 5)
    for env in envs.values():
        env.close()


def edited(model: mujoco.MjModel, events: Array) -> mujoco.MjModel:
    """Return a copy of a model with the numbers that events have drawn."""
    friction, strength, kp, kd, damping, armature = events[:6]
    changed = copy.copy(model)
    changed.geom_friction *= friction
    changed.pair_friction *= friction
    changed.dof_damping *= damping
    changed.dof_armature *= armature
    changed.actuator_gainprm[:, 0] *= strength * kp
    changed.actuator_biasprm[:, 1] *= strength * kp
    changed.actuator_biasprm[:, 2] *= strength * kd
    changed.actuator_forcerange *= strength
    changed.opt.gravity = 9.81 * events[6:9]
    return changed


def test_what_events_draw_stays_within_its_ranges_and_differs_between_envs(make: Make) -> None:
    env = make(observed('{ term = "events" }') + SURVIVE + EVENTS, "lanes", num_envs=256)
    drawn = env.reset()[0].astype(np.float64)
    for column, (low, high) in enumerate(
        ((0.4, 1.6), (0.6, 1.4), (0.7, 1.3), (0.5, 2.0), (0.5, 2.0), (0.5, 2.0))
    ):
        values = drawn[:, column]
        assert low <= values.min() < low + 0.05 * (high - low)
        assert high - 0.05 * (high - low) < values.max() <= high
    np.testing.assert_allclose(np.linalg.norm(drawn[:, 6:9], axis=1), 1.0, rtol=1e-6)
    angles = np.arccos(-drawn[:, 8])
    assert angles.max() <= 0.3 + 1e-3
    assert angles.std() == pytest.approx(0.3 / np.sqrt(12), rel=0.15)
    assert np.abs(drawn[:, 9:13]).max() <= 0.1
    assert set(drawn[:, 13]) == {0, 1, 2, 3}
    again = make(observed('{ term = "events" }') + SURVIVE + EVENTS, "mujoco", num_envs=256)
    np.testing.assert_array_equal(again.reset()[0], drawn.astype(np.float32))
    env.close()
    again.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_infos_hold_the_command_of_the_next_step_and_what_the_events_have_drawn(
    make: Make, backend: str
) -> None:
    env = make(observed('{ term = "command" }, { term = "events" }') + SURVIVE + EVENTS, backend)
    joints = ["right_knee", "right_hip", "left_hip", "left_knee"]
    expected = ["friction", "motor_strength", "kp", "kd", "joint_damping", "joint_armature"]
    expected += ["gravity x", "gravity y", "gravity z", *(f"encoder_bias {joint}" for joint in joints)]
    assert env.event_names == [*expected, "action_delay"]
    obs, infos = env.reset()
    for _ in range(30):
        shown = np.concatenate([infos["command"], infos["events"]], axis=1)
        np.testing.assert_array_equal(shown.astype(np.float32), obs)
        assert infos["_command"].all()
        assert infos["_events"].all()
        obs, _, _, _, infos = env.step(np.zeros((ENVS, 4)))
    env.close()
    plain = make(observed('{ term = "joint_pos" }') + SURVIVE, backend)
    assert plain.event_names == []
    assert "events" not in plain.reset()[1]
    plain.close()


@pytest.mark.parametrize("backend", BACKENDS)
def test_a_saved_state_holds_all_that_a_task_remembers(make: Make, backend: str) -> None:
    terms = ALL_TERMS[:-2] + ', { term = "joint_vel", delay = 1, history = 2, noise = 0.1 }]\n'
    env = make(terms + REWARDS + EVENTS, backend)
    rng = np.random.default_rng(4)
    env.reset()
    for _ in range(10):
        env.step(rng.uniform(-1, 1, (ENVS, 4)))
    replayed(env, rng.uniform(-1, 1, (10, ENVS, 4)), lambda step: [*step[:2], env.reward_terms])
    env.close()


MY_TERMS = """
import numpy as np

def phase(batch):
    return np.column_stack([batch.qpos[:, 2], batch.actions[:, 0] + batch.damage_class])

def energy(batch):
    return (batch.qvel ** 2).sum(axis=1) * batch.dt

def low(batch):
    return batch.qpos[:, 2] < 0.3

def wrong(batch):
    return np.zeros(len(batch.qpos) + 1)

def broken(batch):
    raise KeyError("no such joint")
"""
PYTHON = """
[observation.policy]
terms = [
  { term = "base_height" },
  { term = "python", function = "my_terms:phase", size = 2 },
  { term = "command" },
]
[rewards]
survive = { weight = 1.0 }
energy = { term = "python", function = "my_terms:energy", weight = -0.5 }
[terminations.python]
functions = ["my_terms:low"]
"""


@pytest.mark.parametrize("backend", BACKENDS)
def test_terms_may_be_python_functions_over_all_envs(
    make: Make,
    backend: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    (tmp_path / "my_terms.py").write_text(MY_TERMS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "my_terms", raising=False)
    env = make(PYTHON, backend, autoreset="same_step")
    obs, _ = env.reset(options={"damage_class": 1})
    np.testing.assert_allclose(obs[:, 1], obs[:, 0], rtol=1e-6)
    np.testing.assert_array_equal(obs[:, 2], np.ones(ENVS))  # no action yet, and damage class 1
    rng, failures = np.random.default_rng(6), 0
    for _ in range(120):
        action = rng.uniform(-2, 2, (ENVS, 4)).astype(np.float32)
        obs, rewards, terminated, _, infos = env.step(action)
        qpos, qvel = env.get_state()
        for index in range(ENVS):
            if terminated[index]:
                failures += 1
                last = infos["final_obs"][index]
                assert last[1] < 0.3
                assert last[0] == pytest.approx(last[1])
                assert obs[index, 1] == pytest.approx(qpos[index, 2], rel=1e-6)  # that of the next episode
                continue
            assert qpos[index, 2] >= 0.3
            np.testing.assert_allclose(
                obs[index, 1:3], [qpos[index, 2], action[index, 0] + infos["damage_class"][index]], rtol=1e-5
            )
            energy = -0.5 * DT * np.sum(qvel[index] ** 2)
            assert env.reward_terms[index] == pytest.approx([energy, 1.0])
            assert rewards[index] == pytest.approx(1.0 + energy)
    assert failures > 0
    env.close()
    for old, new, error in (
        ("my_terms:energy", "my_terms:wrong", r"the term my_terms:wrong returned shape \(4,\)"),
        ("my_terms:energy", "my_terms:broken", "a term of the task raised KeyError.*no such joint"),
        ("my_terms:energy", "my_terms:missing", "has no function 'missing'"),
        ("my_terms:energy", "no_module:energy", "cannot import the module 'no_module'"),
        ("my_terms:energy", "my_terms", '`function` is "my_terms", expected "module:function"'),
    ):
        with pytest.raises(db.ConfigError, match=f"(?s){error}"):
            one_step(make, PYTHON.replace(old, new), backend)
    with pytest.raises(
        db.ConfigError, match="`my_terms:phase` is computed in Python, which keeps no earlier"
    ):
        make(PYTHON, backend, history=2)


def one_step(make: Make, task: str, backend: str) -> None:
    env = make(task, backend)
    env.reset()
    env.step(np.zeros((ENVS, 4)))


def test_a_training_with_a_task_resumes_exactly(
    make: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "my_terms.py").write_text(MY_TERMS)
    monkeypatch.chdir(tmp_path)
    monkeypatch.delitem(sys.modules, "my_terms", raising=False)
    terms = '{ term = "base_lin_vel", noise = 0.1, history = 2 }, { term = "events" }'
    critic = f"[observation.critic]\nterms = [{terms}]\n"
    curriculum = "[curriculum.commands]\nstart = 0.2\nsteps = 60\n"
    task = PYTHON.replace("[rewards]\n", critic + REWARDS).replace("survive = { weight = 1.0 }\n", "", 1)
    make(task + EVENTS + curriculum, "lanes").close()
    whole = trained_twice(tmp_path, str(tmp_path / "walker.toml"), iterations=6)
    # The first of the terms that track the commands has a weight of 2.
    tracked = whole.metrics["reward_track_lin_vel"] / 2
    np.testing.assert_allclose(whole.metrics["tracking"], tracked, rtol=1e-12)
    assert {"reward_energy", "reward_track_lin_vel"} <= whole.metrics.keys()
    policy = db.Policy.load(whole.path)
    # The policy observes 1 + 2 + 3 entries and a damage code, and nothing that the critic alone is given.
    assert policy.obs_dim == 6
    assert whole.metrics["env_steps"][-1] == 768


def test_an_export_holds_the_contract_of_observations_and_controls(make: Make, tmp_path: Path) -> None:
    critic = '[observation.critic]\nterms = [{ term = "base_lin_vel" }]\n'
    terms = '{ term = "joint_vel", scale = 0.1, noise = 0.5, history = 2 }, { term = "command" }'
    make(observed(terms) + critic + SURVIVE, "lanes").close()
    run = db.train(
        tmp_path / "run",
        robot=str(tmp_path / "walker.toml"),
        num_envs=4,
        total_steps=128,
        set={"horizon": 16, "ppo.hidden": [8], "evaluation.episodes": 1},
    )
    exported = db.export(run.path, tmp_path / "export")
    header = json.loads((tmp_path / "export" / "export.json").read_text())
    assert header["obs_dim"] == 2 * 4 + 3
    assert header["twin"]["observation"] == [
        {"term": "joint_vel", "noise": 0.5, "scale": 0.1, "history": 2},
        {"term": "command"},
    ]
    home = {"right_knee": -0.5, "right_hip": -0.2, "left_hip": 0.3, "left_knee": -0.8}
    expected = [
        ("actuator 0", "right_knee"),
        *((name, name) for name in ("right_hip", "left_hip", "left_knee")),
    ]
    for entry, (name, joint) in zip(header["twin"]["actuators"], expected, strict=True):
        scale = 0.5 if "hip" in name else 0.25
        assert entry == {"name": name, "offset": home[joint], "scale": scale}
    assert "action_scale" not in header["twin"]
    assert exported is not None
