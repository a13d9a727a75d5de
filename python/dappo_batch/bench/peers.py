"""What else `bench` measures: environments by others, where they are installed."""

from __future__ import annotations

import ctypes
import importlib
import importlib.metadata
import importlib.util
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from dappo_batch.bench.contenders import Contender, Unavailable
from dappo_batch.bench.workload import Workload

__all__ = ["EnvPoolAnt", "GymnasiumAnt", "envpool_mujoco"]

_ENV_ID = "Ant-v5"


def _require_ant(workload: Workload, name: str) -> None:
    if workload.robot.name != "ant":
        raise Unavailable(f"{name} has no robot {workload.robot.name!r}, only the Ant")


class GymnasiumAnt(Contender):
    """Gymnasium's own Ant, one env after the other in one thread."""

    key = "gymnasium"
    about = f"SyncVectorEnv of {_ENV_ID}: one thread; observation, reward, reset"
    _MOST = 32  # its cost an env step does not depend on their number, but each env loads the model anew

    def __init__(self, workload: Workload) -> None:
        _require_ant(workload, "gymnasium")
        self.num_envs = min(workload.num_envs, self._MOST)
        try:
            self._envs = gymnasium.vector.SyncVectorEnv(
                [lambda: gymnasium.make(_ENV_ID) for _ in range(self.num_envs)]
            )
        except (ImportError, gymnasium.error.Error) as error:
            reason = f"gymnasium cannot make {_ENV_ID}: {error}"
            raise Unavailable(reason, "pip install 'gymnasium[mujoco]'") from error
        self.note = f"gymnasium {gymnasium.__version__}, {self.num_envs} envs"
        self._actions = workload.actions(self.num_envs)
        self._envs.reset(seed=workload.seed)
        for env, qpos, qvel in zip(self._envs.envs, *workload.states(self.num_envs), strict=True):
            base: Any = env.unwrapped
            base.set_state(qpos, qvel)

    def advance(self) -> int:
        """Advance all environments by one env step and return how many env steps that were."""
        self._envs.step(self._actions.next())
        return self.num_envs

    def close(self) -> None:
        """Free threads and memory."""
        self._envs.close()


class EnvPoolAnt(Contender):
    """EnvPool's Ant, with the MuJoCo it brings along."""

    key = "envpool"
    about = f"EnvPool {_ENV_ID}, synchronous: observation, reward, reset"
    _MOST = 256  # 0.8 MB an env; 4096 envs were measured to be no faster
    _SETTLING_STEPS = 40  # it cannot be put into a state, so its robots must fall to the floor by themselves

    def __init__(self, workload: Workload) -> None:
        _require_ant(workload, "EnvPool")
        if importlib.util.find_spec("envpool") is None:
            raise Unavailable("envpool is not installed", "pip install envpool")
        self.num_envs = min(workload.num_envs, self._MOST)
        try:
            envpool = importlib.import_module("envpool")
            self._envs = envpool.make(
                _ENV_ID,
                env_type="gymnasium",
                num_envs=self.num_envs,
                num_threads=workload.threads,
                seed=workload.seed,
            )
        except Exception as error:
            # A foreign binary: whatever it raises is a reason to go on without it, and to say so.
            raise Unavailable(f"envpool cannot make {_ENV_ID}: {type(error).__name__}: {error}") from error
        version = importlib.metadata.version("envpool")
        self.note = f"envpool {version} with MuJoCo {envpool_mujoco(envpool)}, {self.num_envs} envs"
        self._actions = workload.actions(self.num_envs, np.float64)
        self._envs.reset()

    def warm_up(self) -> None:
        """Do what must not be timed."""
        for _ in range(self._SETTLING_STEPS):
            self.advance()

    def advance(self) -> int:
        """Advance all environments by one env step and return how many env steps that were."""
        self._envs.step(self._actions.next())
        return self.num_envs

    def close(self) -> None:
        """Free threads and memory."""
        self._envs.close()


def envpool_mujoco(envpool: Any) -> str:  # noqa: ANN401 - a module
    """Return the version of the MuJoCo inside EnvPool."""
    for library in Path(envpool.__file__).parent.glob("mujoco/mujoco_gym_envpool*.so"):
        try:
            function = ctypes.CDLL(str(library)).mj_versionString
        except (OSError, AttributeError):
            continue
        function.restype = ctypes.c_char_p
        return str(function().decode())
    return "unknown"
