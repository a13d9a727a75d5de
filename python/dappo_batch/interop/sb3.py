"""Stable-Baselines3: the vector env as its ``VecEnv``."""

from __future__ import annotations

from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices

from dappo_batch._core import ConfigError
from dappo_batch.envs import DamageVectorEnv
from dappo_batch.interop import check_envs

__all__ = ["Sb3VecEnv"]

Row = dict[str, Any]


class Sb3VecEnv(VecEnv):
    """A `DamageVectorEnv` as a ``VecEnv`` of Stable-Baselines3.

    It returns the same as ``DummyVecEnv`` with N single envs. ``VecMonitor`` and ``VecNormalize`` can wrap
    it.

    Parameters
    ----------
    envs : DamageVectorEnv
        Created with ``autoreset="same_step"``.

    Attributes
    ----------
    envs : DamageVectorEnv
        The same object.

    Raises
    ------
    ConfigError
        If `envs` have another autoreset mode or return views.
    """

    def __init__(self, envs: DamageVectorEnv) -> None:
        check_envs(envs, AutoresetMode.SAME_STEP)
        self.envs = envs  # before the base class, which asks for attributes
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self.metadata = envs.metadata

    def reset(self) -> NDArray[np.float32]:
        """Begin a new episode in every env, with the seeds and options of `seed` and `set_options`.

        Returns
        -------
        obs : array of shape [N, O]
            First observations; the infos are in `reset_infos`, one dict for each env.
        """
        keys = sorted(set().union(*self._options))
        options = {key: [chosen.get(key) for chosen in self._options] for key in keys}
        obs, infos = self.envs.reset(seed=self._seeds, options=options)
        self.reset_infos = _rows(infos)
        self._reset_seeds()
        self._reset_options()
        return obs

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Store the actions, shape [N, A], for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.bool_], list[Row]]:
        """Advance every env by one step.

        Returns
        -------
        obs : array of shape [N, O]
            Observations; where an episode ended, the first one of the next episode.
        rewards : array of shape [N]
        dones : array of shape [N]
            Terminated or truncated.
        infos : list of N dicts
            The infos of `DamageVectorEnv.step`, ``TimeLimit.truncated`` (truncated and not
            terminated), and where an episode ended ``terminal_observation``, shape [O].
        """
        obs, rewards, terminated, truncated, infos = self.envs.step(self._actions)
        dones = terminated | truncated
        rows = _rows(infos)
        if dones.any():
            last = _rows(infos["final_info"])
            for index in np.flatnonzero(dones):
                self.reset_infos[index] = rows[index]
                rows[index] = last[index]
                rows[index]["terminal_observation"] = infos["final_obs"][index]
        for row, out_of_time in zip(rows, (truncated & ~terminated).tolist(), strict=True):
            row["TimeLimit.truncated"] = out_of_time
        return obs, rewards.astype(np.float32), dones, rows

    def close(self) -> None:
        """Free the native memory."""
        self.envs.close()

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return the attribute of the vector env, which all envs share, once for each of `indices`."""
        return [getattr(self.envs, attr_name)] * len(self._get_indices(indices))

    def set_attr(self, attr_name: str, value: object, indices: VecEnvIndices = None) -> None:
        """Raise, as the envs have no separate attributes.

        Raises
        ------
        ConfigError
            Always.
        """
        raise ConfigError(f"set_attr: the envs share all attributes, got {attr_name!r}; set it on `envs`")

    def env_method(
        self, method_name: str, *method_args: object, indices: VecEnvIndices = None, **method_kwargs: object
    ) -> list[Any]:
        """Call ``get_state``; returns (qpos, qvel) for each of `indices`.

        Raises
        ------
        ConfigError
            If another method is called: those of the vector env act on all envs.
        """
        if method_name != "get_state":
            raise ConfigError(
                f"env_method: expected 'get_state', got {method_name!r}; "
                "methods that act on all envs are those of `envs`"
            )
        qpos, qvel = self.envs.get_state()
        return [(qpos[index], qvel[index]) for index in self._get_indices(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: VecEnvIndices = None) -> list[bool]:
        """Return False for each of `indices`, as there are no single envs to wrap."""
        return [False] * len(self._get_indices(indices))


def _rows(infos: Row) -> list[Row]:
    """Return one dict of Python numbers for each env, without the masks ``_key``."""
    columns = {key: array.tolist() for key, array in infos.items() if not key.startswith(("_", "final_"))}
    return [dict(zip(columns, row, strict=True)) for row in zip(*columns.values(), strict=True)]
