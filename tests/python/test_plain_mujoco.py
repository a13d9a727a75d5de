"""With the backend `mujoco`, every env does what plain MuJoCo does with its class's compiled model."""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

import dappo_batch
from dappo_batch import ClassTable

STEPS = 50


class PlainRobot:
    """One env of a class table, stepped with MuJoCo's Python bindings."""

    def __init__(self, table: ClassTable, damage_class: int) -> None:
        self.table = table
        self.spec = table.robot.spec
        self.use(damage_class)

    def use(self, damage_class: int) -> None:
        """Take another class's model and keep the whole simulation state, warm start included."""
        model = self.table.models[damage_class]
        data = mujoco.MjData(model)
        if hasattr(self, "data"):
            whole = int(mujoco.mjtState.mjSTATE_INTEGRATION)
            state = np.empty(mujoco.mj_stateSize(model, whole))
            mujoco.mj_getState(self.model, self.data, state, whole)
            mujoco.mj_setState(model, data, state, whole)
            data.xpos[:] = self.data.xpos
        self.model, self.data, self.damage_class = model, data, damage_class

    def start(self, qpos: NDArray[np.float64], qvel: NDArray[np.float64]) -> None:
        """Begin an episode in the given state, as Gymnasium does."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:], self.data.qvel[:] = qpos, qvel
        mujoco.mj_forward(self.model, self.data)

    def step(self, action: NDArray[np.float32]) -> None:
        """Advance by one env step."""
        before = self.data.xpos[self.table.main_body, 0]
        scale = float(self.spec["action_scale"])
        self.data.ctrl[:] = scale * np.clip(action.astype(np.float64), -1.0, 1.0)
        mujoco.mj_step(self.model, self.data, nstep=self.spec["frame_skip"])
        mujoco.mj_rnePostConstraint(self.model, self.data)
        seconds = self.model.opt.timestep * self.spec["frame_skip"]
        self.forward_velocity = (self.data.xpos[self.table.main_body, 0] - before) / seconds

    def observation(self) -> NDArray[np.float32]:
        """Return the observation that SPEC section 2 (Ant) or 3 (Hexapod) describes, [O]."""
        data = self.data
        parts = [data.qpos[2:], data.qvel]
        if self.table.robot.name == "ant":
            parts.append(np.clip(data.cfrc_ext, -1.0, 1.0).ravel())
        else:
            touch = data.sensordata[list(self.table.touch_addresses)] > 0.0
            touch[list(self.table.disabled_touch[self.damage_class])] = False
            parts.append(touch.astype(np.float64))
        code = self.table.space.classes[self.damage_class].code
        return np.concatenate([*parts, np.asarray(code, dtype=np.float64)]).astype(np.float32)

    def paper_reward(self, action: NDArray[np.float32], terminated: bool) -> float:
        """Return the paper's reward: velocity + survival - contacts - loads - effort."""
        forces = self.data.cfrc_ext
        contacts = sum(bool(forces[list(bodies)].any()) for bodies in self.table.limb_bodies)
        effort = np.clip(action.astype(np.float64), -1.0, 1.0)
        if self.table.robot.name == "ant":
            return float(
                self.forward_velocity
                + (not terminated)
                - 0.5 * contacts
                - (0.5 * np.linalg.norm(effort)) ** 2
            )
        loads = (np.clip(forces, -10.0, 10.0) ** 2).sum(axis=1)
        return float(
            self.forward_velocity
            + 0.1 * (not terminated)
            - 0.03 * contacts
            - (0.0005 * np.linalg.norm(loads)) ** 2
            - (0.05 * np.linalg.norm(0.785 * effort)) ** 2
        )


def mixed_envs(table: ClassTable, **options: Any) -> tuple[dappo_batch.DamageVectorEnv, list[PlainRobot]]:  # noqa: ANN401
    """Return one env per damage class and plain MuJoCo robots in the same states."""
    count = len(table.models)
    options |= {"autoreset": "disabled", "seed": 0, "backend": "mujoco"}
    envs = dappo_batch.make_vec(table, count, **options)
    envs.reset(options={"damage_class": np.arange(count)})
    robots = [PlainRobot(table, index) for index in range(count)]
    for robot, qpos, qvel in zip(robots, *envs.get_state(), strict=True):
        robot.start(qpos, qvel)
    return envs, robots


def test_every_class_moves_observes_and_rewards_like_plain_mujoco_bit_for_bit(table: ClassTable) -> None:
    envs, robots = mixed_envs(table, reward="paper")
    classes = np.arange(len(robots))
    rng = np.random.default_rng(3)
    for step in range(STEPS):
        actions = rng.uniform(-1.1, 1.1, envs.action_space.shape).astype(np.float32)
        obs, rewards, terminated, truncated, infos = envs.step(actions)
        np.testing.assert_array_equal(infos["damage_class"], classes)
        qpos, qvel = envs.get_state()
        for index, robot in enumerate(robots):
            robot.step(actions[index])
            where = f"class {index}, step {step}"
            np.testing.assert_array_equal(qpos[index], robot.data.qpos, err_msg=where)
            np.testing.assert_array_equal(qvel[index], robot.data.qvel, err_msg=where)
            np.testing.assert_array_equal(obs[index], robot.observation(), err_msg=where)
            assert infos["forward_velocity"][index] == pytest.approx(
                robot.forward_velocity, rel=1e-12, abs=1e-12
            )
            expected = robot.paper_reward(actions[index], bool(terminated[index]))
            assert rewards[index] == pytest.approx(expected, rel=1e-9, abs=1e-12), where
        ended = terminated | truncated
        if ended.any():
            envs.reset(options={"reset_mask": ended, "damage_class": classes})
            for index in np.flatnonzero(ended):
                robots[index].start(*(part[index] for part in envs.get_state()))


def test_damage_in_mid_episode_switches_the_model_exactly_at_its_onset(table: ClassTable) -> None:
    count = len(table.models)
    onset = 7
    envs, robots = mixed_envs(table, onset=onset)
    for robot in robots:
        robot.use(0)
    rng = np.random.default_rng(4)
    ended = np.zeros(count, dtype=np.bool_)
    for step in range(1, 21):
        actions = rng.uniform(-1.0, 1.0, envs.action_space.shape).astype(np.float32)
        obs, _, terminated, _, infos = envs.step(actions)
        qpos, qvel = envs.get_state()
        # Steps 1 to `onset` are healthy; infos and code have the active damage of the step.
        in_force = np.arange(count) if step > onset else np.zeros(count, dtype=np.int64)
        np.testing.assert_array_equal(infos["damage_onset"][~ended], onset)
        np.testing.assert_array_equal(infos["damage_class"][~ended], in_force[~ended])
        for index in np.flatnonzero(~ended):
            robot = robots[index]
            robot.step(actions[index])
            np.testing.assert_array_equal(qpos[index], robot.data.qpos, err_msg=f"class {index}, step {step}")
            np.testing.assert_array_equal(qvel[index], robot.data.qvel, err_msg=f"class {index}, step {step}")
            if step == onset:
                robot.use(index)
            np.testing.assert_array_equal(
                obs[index, envs.single_observation_space.shape[0] - table.space.code_length :],
                table.space.classes[in_force[index]].code,
            )
        if terminated.any():  # leave ended envs alone from here on; the reset only lets the others go on
            ended |= terminated
            envs.reset(options={"reset_mask": terminated})
    assert ended.mean() < 0.5


def test_a_missing_toe_has_no_touch_signal(hexapod_table: ClassTable, backend: str) -> None:
    specs = ["healthy", *(f"missing_toe@{limb}" for limb in range(6))]
    options: dict[str, Any] = {"autoreset": "disabled", "seed": 0, "observe_damage": False}
    envs = dappo_batch.make_vec(hexapod_table, 7, backend=backend, **options)
    envs.reset(options={"damage_class": specs})
    actions = np.zeros(envs.action_space.shape, dtype=np.float32)
    touched = np.zeros((7, 6), dtype=np.bool_)
    for _ in range(100):
        obs, _, terminated, _, _ = envs.step(actions)
        assert not terminated.any()
        assert set(np.unique(obs[:, 47:])) <= {0.0, 1.0}
        touched |= obs[:, 47:] > 0.0
    assert touched[0].all()
    for limb in range(6):
        assert not touched[limb + 1, limb]
        assert touched[limb + 1].sum() >= 3


@pytest.mark.slow
def test_all_hexapod_classes_stay_finite_for_a_thousand_random_steps(
    hexapod_table: ClassTable, backend: str
) -> None:
    options: dict[str, Any] = {"autoreset": "same_step", "seed": 0, "copy": False}
    envs = dappo_batch.make_vec(hexapod_table, 73, backend=backend, **options)
    classes = np.arange(73)
    envs.reset(options={"damage_class": classes})
    rng = np.random.default_rng(5)
    for _ in range(1000):
        actions = rng.uniform(-1.0, 1.0, envs.action_space.shape).astype(np.float32)
        obs, rewards, _, _, _ = envs.step(actions)
        assert np.isfinite(obs).all()
        assert np.isfinite(rewards).all()
    assert all(np.isfinite(part).all() for part in envs.get_state())
