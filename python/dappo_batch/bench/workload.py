"""The work that every contender does: one robot, the same states to begin with, the same random actions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from dappo_batch.robots import Robot, load_robot

__all__ = ["Episodes", "Workload"]

_POOL_SIZE = 512
_POOL_SPACING = 5  # env steps between two states of the pool


@dataclass(frozen=True, eq=False)
class Workload:
    """What is simulated, and by how much hardware.

    Attributes
    ----------
    robot : Robot
        The robot.
    num_envs : int
        Number of environments N; contenders that cost too much memory or time a piece use fewer.
    threads : int
        Threads of each contender.
    seed : int
        Seed of states and actions.
    """

    robot: Robot
    num_envs: int
    threads: int
    seed: int = 0

    @classmethod
    def of(cls, robot: str, num_envs: int, threads: int, seed: int = 0) -> Workload:
        """Load `robot` by name or path and return the workload."""
        return cls(load_robot(robot), num_envs, threads, seed)

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The MJCF as anybody would compile it, without the edits that make this package faster."""
        return mujoco.MjModel.from_xml_path(str(self.robot.mjcf_path))

    @property
    def frame_skip(self) -> int:
        """Physics steps in an env step."""
        return int(self.robot.spec["frame_skip"])

    @cached_property
    def height(self) -> tuple[float, float]:
        """Allowed height of the root, m; an episode ends outside of it."""
        low, high = self.robot.spec.get("termination", {}).get("height", (-np.inf, np.inf))
        return float(low), float(high)

    @property
    def max_episode_steps(self) -> int:
        """Env steps after which an episode is cut off."""
        return int(self.robot.spec["max_episode_steps"])

    def rng(self, stream: int = 0) -> np.random.Generator:
        """Return a random generator; equal streams give equal numbers."""
        return np.random.default_rng([self.seed, stream])

    def first_state(self, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Draw the state in which an episode begins: positions [nq] and velocities [nv]."""
        noise = self.robot.spec.get("reset", {})
        model = self.model
        qpos = model.qpos0 + noise.get("qpos_noise", 0.0) * rng.uniform(-1.0, 1.0, model.nq)
        return qpos, noise.get("qvel_noise", 0.0) * rng.standard_normal(model.nv)

    @cached_property
    def _pool(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """States met by the randomly moving healthy robot, [P, nq] and [P, nv].

        Contacts decide what a step costs, so nobody may be timed while its robots still fall to the floor.
        """
        rng, model = self.rng(1), self.model
        data = mujoco.MjData(model)
        episodes = Episodes(self, 1)
        size = min(self.num_envs, _POOL_SIZE)
        qpos, qvel = np.empty((size, model.nq)), np.empty((size, model.nv))
        data.qpos[:], data.qvel[:] = self.first_state(rng)
        for index in range(size):
            for _ in range(_POOL_SPACING):
                data.ctrl[:] = rng.uniform(-1.0, 1.0, model.nu)
                mujoco.mj_step(model, data, nstep=self.frame_skip)
                if episodes.ended(data.qpos[2:3]).size:
                    mujoco.mj_resetData(model, data)
                    data.qpos[:], data.qvel[:] = self.first_state(rng)
            qpos[index], qvel[index] = data.qpos, data.qvel
        return qpos, qvel

    def states(self, count: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return states to begin with: positions [count, nq] and velocities [count, nv]."""
        qpos, qvel = self._pool
        chosen = self.rng(2).integers(0, len(qpos), count)
        return qpos[chosen], qvel[chosen]

    def actions(self, count: int, dtype: type[np.floating[Any]] = np.float32) -> Actions:
        """Return an endless supply of random actions, each an array [count, nu]."""
        return Actions(self.rng(3), count, self.model.nu, dtype)


class Actions:
    """Random actions in [-1, 1] that cost nothing to draw: windows of one large array."""

    def __init__(
        self, rng: np.random.Generator, count: int, width: int, dtype: type[np.floating[Any]]
    ) -> None:
        self._count = count
        self._spare = 997
        self._bank = rng.uniform(-1.0, 1.0, (count + self._spare, width)).astype(dtype)
        self._calls = 0

    def next(self) -> NDArray[Any]:
        """Return the next batch, [count, width]; a view."""
        # A stride that shares no factor with the number of windows visits all of them before repeating.
        start = self._calls * 101 % self._spare
        self._calls += 1
        return self._bank[start : start + self._count]


class Episodes:
    """Says which episodes end, for contenders that know physics only."""

    def __init__(self, workload: Workload, count: int) -> None:
        self._low, self._high = workload.height
        self._limit = workload.max_episode_steps
        self._steps = np.zeros(count, dtype=np.int64)

    def ended(self, heights: NDArray[np.float64]) -> NDArray[np.intp]:
        """Count a step of every env and return the indices of those whose episode ended.

        Parameters
        ----------
        heights : array of shape [count]
            Height of each root, m; not a number counts as ended.
        """
        self._steps += 1
        alive = (heights >= self._low) & (heights <= self._high) & (self._steps < self._limit)
        indices = np.flatnonzero(~alive)
        self._steps[indices] = 0
        return indices
