"""The simulators that `bench` measures: this package, plain MuJoCo, and other libraries."""

from __future__ import annotations

import importlib
import importlib.metadata
import importlib.util
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import cycle
from typing import Any

import gymnasium
import mujoco
import numpy as np
from numpy.typing import NDArray

from dappo_batch._core import ConfigError
from dappo_batch.envs import make_vec
from dappo_batch.envs.options import Backend, Precision
from dappo_batch.model.robot_spec import read_robot_spec
from dappo_batch.robots import Robot

__all__ = ["SIMULATORS", "Simulator", "Unavailable", "Workload"]

_ENV_ID = "Ant-v5"


class Unavailable(Exception):
    """A simulator cannot run here. The text is the reason, `install` the command that installs it."""

    def __init__(self, reason: str, install: str = "") -> None:
        super().__init__(reason)
        self.install = install


@dataclass(frozen=True, eq=False)
class Workload:
    """A robot, the number of environments N, threads of each simulator, and the seed of states and actions.

    Simulators whose environments need too much memory or time use fewer.
    """

    robot: Robot
    num_envs: int
    threads: int
    seed: int = 0

    @cached_property
    def model(self) -> mujoco.MjModel:
        """The robot as compiled by MuJoCo, without the edits that make this package faster."""
        return read_robot_spec(self.robot)[0].compile()

    @property
    def limits(self) -> tuple[float, float, int]:
        """Lowest and highest root of an episode, m, and the env steps after which it is truncated."""
        low, high = self.robot.spec.get("termination", {}).get("height", (-np.inf, np.inf))
        return float(low), float(high), int(self.robot.spec["max_episode_steps"])

    def rng(self, stream: int) -> np.random.Generator:
        """Return the random generator of a stream."""
        return np.random.default_rng([self.seed, stream])

    def reset(self, data: mujoco.MjData, rng: np.random.Generator) -> None:
        """Begin an episode."""
        noise, model = self.robot.spec.get("reset", {}), self.model
        mujoco.mj_resetData(model, data)
        data.qpos[:] += noise.get("qpos_noise", 0.0) * rng.uniform(-1.0, 1.0, model.nq)
        data.qvel[:] = noise.get("qvel_noise", 0.0) * rng.standard_normal(model.nv)

    def actions(self, count: int, dtype: type[np.floating[Any]] = np.float32) -> Iterator[NDArray[Any]]:
        """Return an infinite iterator of random actions in [-1, 1], arrays of shape [count, nu]."""
        windows = 997
        bank = self.rng(0).uniform(-1.0, 1.0, (count + windows, self.model.nu)).astype(dtype)
        return (bank[start : start + count] for start in cycle(range(windows)))


class Simulator(ABC):
    """A simulator of robots; `note` contains its version."""

    num_envs: int
    note: str = ""

    @abstractmethod
    def run_for(self, seconds: float, steps: int = 1) -> int:
        """Advance every env for at least `seconds` and `steps`; return the env steps of all envs."""

    @abstractmethod
    def close(self) -> None:
        """Free threads and memory."""


class VectorEnv(Simulator):
    """A vector env: observation, reward and reset included."""

    envs: Any
    actions: Iterator[NDArray[Any]]

    def run_for(self, seconds: float, steps: int = 1) -> int:
        """Advance every env for at least `seconds` and `steps`; return the env steps of all envs."""
        end, done = time.perf_counter() + seconds, 0
        while done < steps or time.perf_counter() < end:
            self.envs.step(next(self.actions))
            done += 1
        return done * self.num_envs

    def close(self) -> None:
        """Free threads and memory."""
        self.envs.close()


class Ours(VectorEnv):
    """The public vector env of this package, with ``copy=False``."""

    def __init__(
        self,
        workload: Workload,
        *,
        backend: Backend = "lanes",
        precision: Precision = "f32",
        damage: str = "healthy",
    ) -> None:
        self.num_envs = workload.num_envs
        try:
            self.envs = make_vec(
                workload.robot,
                workload.num_envs,
                damage=damage,
                threads=workload.threads,
                seed=workload.seed,
                copy=False,
                backend=backend,
                precision=precision,
            )
        except ConfigError as error:
            raise Unavailable(str(error)) from error
        self.actions = workload.actions(self.num_envs)
        self.envs.reset()


class RawStep(Simulator):
    """Only physics: one ``mjData`` for each thread, stepped in a loop. The base of all ratios."""

    def __init__(self, workload: Workload) -> None:
        self._workload, self.num_envs = workload, workload.threads
        self._pool = ThreadPoolExecutor(workload.threads)  # mj_step releases the interpreter's lock
        self._data = [mujoco.MjData(workload.model) for _ in range(self.num_envs)]
        self._rngs = [workload.rng(1 + index) for index in range(self.num_envs)]
        for data, rng in zip(self._data, self._rngs, strict=True):
            workload.reset(data, rng)

    def run_for(self, seconds: float, steps: int = 1) -> int:
        """Advance every env for at least `seconds` and `steps`; return the env steps of all envs."""
        work = partial(self._run_one, time.perf_counter() + seconds, steps)
        return sum(self._pool.map(work, self._data, self._rngs))

    def _run_one(self, end: float, steps: int, data: mujoco.MjData, rng: np.random.Generator) -> int:
        model, (low, high, limit) = self._workload.model, self._workload.limits
        skip, done = int(self._workload.robot.spec["frame_skip"]), 0
        actions, last = rng.uniform(-1.0, 1.0, (1024, model.nu)), (limit * skip - 0.5) * model.opt.timestep
        ctrl, qpos = data.ctrl, data.qpos
        while done < steps or time.perf_counter() < end:
            ctrl[:] = actions[done % 1024]
            mujoco.mj_step(model, data, nstep=skip)
            done += 1
            if not low <= qpos[2] <= high or data.time >= last:
                self._workload.reset(data, rng)
        return done

    def close(self) -> None:
        """Free threads and memory."""
        self._pool.shutdown()


class Gymnasium(VectorEnv):
    """Gymnasium's own Ant, one env after the other in one thread."""

    def __init__(self, workload: Workload) -> None:
        _require_ant(workload)
        self.num_envs = min(workload.num_envs, 32)  # more need memory and are not faster
        try:
            self.envs = gymnasium.vector.SyncVectorEnv(
                [lambda: gymnasium.make(_ENV_ID) for _ in range(self.num_envs)]
            )
        except (ImportError, gymnasium.error.Error) as error:
            reason = f"gymnasium cannot make {_ENV_ID}: {error}"
            raise Unavailable(reason, "pip install 'gymnasium[mujoco]'") from error
        self.note = f"gymnasium {gymnasium.__version__}"
        self.actions = workload.actions(self.num_envs)
        self.envs.reset(seed=workload.seed)


class EnvPool(VectorEnv):
    """EnvPool's Ant, with the MuJoCo inside EnvPool."""

    def __init__(self, workload: Workload) -> None:
        _require_ant(workload)
        if importlib.util.find_spec("envpool") is None:
            raise Unavailable("envpool is not installed", "pip install envpool")
        self.num_envs = min(workload.num_envs, 256)  # 0.8 MB an env; 4096 envs were measured to be no faster
        try:
            envpool = importlib.import_module("envpool")
            self.envs = envpool.make(
                _ENV_ID,
                env_type="gymnasium",
                num_envs=self.num_envs,
                num_threads=workload.threads,
                seed=workload.seed,
            )
        except Exception as error:
            # A third-party binary: any exception means that it cannot be measured, and is reported.
            raise Unavailable(f"envpool cannot make {_ENV_ID}: {type(error).__name__}: {error}") from error
        self.note = f"envpool {importlib.metadata.version('envpool')}"
        self.actions = workload.actions(self.num_envs, np.float64)
        self.envs.reset()


def _require_ant(workload: Workload) -> None:
    if workload.robot.name != "ant":
        raise Unavailable(f"it has no robot {workload.robot.name!r}, only the Ant")


SIMULATORS: dict[str, Callable[[Workload], Simulator]] = {
    "mj_step": RawStep,
    "lanes f32": Ours,
    "lanes f32 damaged": partial(Ours, damage="uniform"),
    "lanes f64": partial(Ours, precision="f64"),
    "mujoco": partial(Ours, backend="mujoco"),
    "envpool": EnvPool,
    "gymnasium": Gymnasium,
}
"""Constructors of the simulators, by name in tables and JSON; they raise `Unavailable`."""
