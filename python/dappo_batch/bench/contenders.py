"""What `bench` measures: this package and MuJoCo's own ways to step many robots."""

from __future__ import annotations

import threading
import time
from abc import ABC, abstractmethod
from typing import ClassVar

import mujoco
import numpy as np

from dappo_batch._core import ConfigError, LaneWorlds
from dappo_batch.bench.workload import Episodes, Workload
from dappo_batch.envs import make_vec
from dappo_batch.envs.simulation import Backend, Precision

__all__ = [
    "Contender",
    "LanesF32",
    "LanesF32Copy",
    "LanesF32Damaged",
    "LanesF64",
    "MujocoBackend",
    "MujocoBatch",
    "MujocoRollout",
    "RawStep",
    "Unavailable",
]


class Unavailable(Exception):
    """A contender cannot run here; the text says why.

    Parameters
    ----------
    reason : str
        What is in the way.
    install : str
        Command that would change it, empty if none does.
    """

    def __init__(self, reason: str, install: str = "") -> None:
        super().__init__(reason)
        self.install = install


class Contender(ABC):
    """Something that advances robots by env steps.

    Attributes
    ----------
    key : str
        Name in tables and JSON.
    about : str
        What it does in an env step.
    num_envs : int
        Environments it advances.
    note : str
        Remarks on this very run, such as the version that was measured.
    """

    key: ClassVar[str]
    about: ClassVar[str]
    num_envs: int
    note: str = ""

    @abstractmethod
    def __init__(self, workload: Workload) -> None: ...

    @abstractmethod
    def advance(self) -> int:
        """Advance all environments by one env step and return how many env steps that were."""

    def run_for(self, seconds: float) -> int:
        """Advance for at least `seconds` and return the number of env steps."""
        end = time.perf_counter() + seconds
        steps = self.advance()
        while time.perf_counter() < end:
            steps += self.advance()
        return steps

    def warm_up(self) -> None:
        """Do what must not be timed."""
        for _ in range(2):
            self.advance()

    def close(self) -> None:  # noqa: B027 (most have nothing to free)
        """Free threads and memory."""


class LanesF32(Contender):
    """The public vector env of this package, healthy robots, arrays returned as views."""

    key = "lanes f32"
    about = "make_vec(copy=False), healthy: observation, reward, reset"
    _backend: ClassVar[Backend] = "lanes"
    _precision: ClassVar[Precision] = "f32"
    _copy: ClassVar[bool] = False
    _damage: ClassVar[str] = "healthy"

    def __init__(self, workload: Workload) -> None:
        self.num_envs = workload.num_envs
        try:
            self._envs = make_vec(
                workload.robot,
                workload.num_envs,
                damage=self._damage,
                threads=workload.threads,
                seed=workload.seed,
                copy=self._copy,
                backend=self._backend,
                precision=self._precision,
            )
        except ConfigError as error:
            raise Unavailable(str(error)) from error
        if self._backend == "lanes":
            world = LaneWorlds(self._envs.table, np.zeros(1, dtype=np.int64), self._precision)
            self.note = f"{world.simd}, {world.width} envs in a register"
        self._actions = workload.actions(self.num_envs)
        self._envs.reset()
        self._envs.set_state(*workload.states(self.num_envs))

    def advance(self) -> int:
        """Advance all environments by one env step and return how many env steps that were."""
        self._envs.step(self._actions.next())
        return self.num_envs

    def close(self) -> None:
        """Free threads and memory."""
        self._envs.close()


class LanesF32Copy(LanesF32):
    """The public vector env as it comes by default."""

    key = "lanes f32 copy"
    about = "make_vec() as by default: every returned array is a copy"
    _copy = True


class LanesF32Damaged(LanesF32):
    """The public vector env with every damage class."""

    key = "lanes f32 damaged"
    about = "make_vec(copy=False), damage drawn from all classes"
    _damage = "uniform"


class LanesF64(LanesF32):
    """The public vector env in double precision."""

    key = "lanes f64"
    about = 'make_vec(copy=False, precision="f64"), healthy'
    _precision = "f64"


class MujocoBackend(LanesF32):
    """The public vector env over libmujoco, for the robots that the lane engine does not know."""

    key = "mujoco"
    about = 'make_vec(copy=False, backend="mujoco"), healthy'
    _backend = "mujoco"


class RawStep(Contender):
    """The physics alone: one ``mjData`` a thread, stepped in a loop; the measure of all others."""

    key = "mj_step"
    about = "the stock model in a loop, one mjData a thread; no observation, no reward"

    def __init__(self, workload: Workload) -> None:
        self._workload = workload
        self.num_envs = workload.threads
        self._data = [mujoco.MjData(workload.model) for _ in range(workload.threads)]
        for data, qpos, qvel in zip(self._data, *workload.states(self.num_envs), strict=True):
            data.qpos[:], data.qvel[:] = qpos, qvel
        self._rngs = [workload.rng(100 + index) for index in range(self.num_envs)]
        self._age = [0] * self.num_envs

    def advance(self) -> int:
        """Advance every thread's robot by one env step and return how many env steps that were."""
        return self.run_for(0.0)

    def run_for(self, seconds: float) -> int:
        """Advance for at least `seconds` and return the number of env steps."""
        counts = [0] * self.num_envs
        end = time.perf_counter() + seconds

        def work(index: int) -> None:
            counts[index] = self._step_until(index, end)

        # mj_step releases the interpreter's lock, so Python threads use all cores.
        threads = [threading.Thread(target=work, args=(index,)) for index in range(self.num_envs)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        return sum(counts)

    def _step_until(self, index: int, end: float) -> int:
        workload, data, rng = self._workload, self._data[index], self._rngs[index]
        model, skip, limit = workload.model, workload.frame_skip, workload.max_episode_steps
        (low, high), age, steps = workload.height, self._age[index], 0
        ctrl, qpos = data.ctrl, data.qpos
        actions = rng.uniform(-1.0, 1.0, (1024, model.nu))
        while True:
            ctrl[:] = actions[steps % 1024]
            mujoco.mj_step(model, data, nstep=skip)
            steps, age = steps + 1, age + 1
            if not low <= qpos[2] <= high or age >= limit:
                mujoco.mj_resetData(model, data)
                data.qpos[:], data.qvel[:] = workload.first_state(rng)
                age = 0
            if time.perf_counter() >= end:
                self._age[index] = age
                return steps

    def warm_up(self) -> None:
        """Do what must not be timed."""
        self.run_for(0.05)


class MujocoRollout(Contender):
    """``mujoco.rollout``, called once an env step as a policy in the loop demands."""

    key = "mujoco.rollout"
    about = "the stock model, one call an env step; no observation, no reward"

    def __init__(self, workload: Workload) -> None:
        # Part of the wheel, but not of the package's namespace.
        from mujoco import rollout

        self._workload = workload
        model = workload.model
        self.num_envs = workload.num_envs
        self._pool = rollout.Rollout(nthread=workload.threads)
        self._data = [mujoco.MjData(model) for _ in range(workload.threads)]
        self._state = np.zeros(
            (self.num_envs, mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        )
        # The row of MuJoCo's full physics state: time, positions, velocities, …
        self._qpos = self._state[:, 1 : 1 + model.nq]
        self._qvel = self._state[:, 1 + model.nq : 1 + model.nq + model.nv]
        self._qpos[:], self._qvel[:] = workload.states(self.num_envs)
        self._actions = workload.actions(self.num_envs, np.float64)
        self._episodes = Episodes(workload, self.num_envs)
        self._rng = workload.rng(4)

    def advance(self) -> int:
        """Advance all environments by one env step and return how many env steps that were."""
        model, skip = self._workload.model, self._workload.frame_skip
        control = np.repeat(self._actions.next()[:, None, :], skip, axis=1)
        states, _ = self._pool.rollout(model, self._data, self._state, control, skip_checks=False)
        self._state[:] = states[:, -1]
        for env in self._episodes.ended(self._qpos[:, 2]):
            self._state[env] = 0.0
            self._qpos[env], self._qvel[env] = self._workload.first_state(self._rng)
        return self.num_envs

    def close(self) -> None:
        """Free threads and memory."""
        self._pool.close()


class MujocoBatch(Contender):
    """``mujoco.batch.Batch``, MuJoCo's own thread pool since 4.0."""

    key = "mujoco.batch"
    about = "the stock model, Batch.step; no observation, no reward"

    def __init__(self, workload: Workload) -> None:
        try:
            from mujoco import batch
        except ImportError:
            reason = f"mujoco {mujoco.__version__} has no mujoco.batch"
            raise Unavailable(reason, "pip install 'mujoco>=4.0'") from None
        self._workload = workload
        self.num_envs = workload.num_envs
        self._batch = batch.Batch(workload.model, self.num_envs, workload.threads)
        self._qpos, self._qvel, self._ctrl = (self._batch.bind(name) for name in ("qpos", "qvel", "ctrl"))
        self._qpos[:], self._qvel[:] = workload.states(self.num_envs)
        self._actions = workload.actions(self.num_envs, np.float64)
        self._episodes = Episodes(workload, self.num_envs)
        self._rng = workload.rng(5)

    def advance(self) -> int:
        """Advance all environments by one env step and return how many env steps that were."""
        self._ctrl[:] = self._actions.next()
        self._batch.step(nstep=self._workload.frame_skip)
        ended = self._episodes.ended(self._qpos[:, 2])
        if ended.size:
            self._batch.reset(ended, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
            for env in ended:
                self._qpos[env], self._qvel[env] = self._workload.first_state(self._rng)
        return self.num_envs
