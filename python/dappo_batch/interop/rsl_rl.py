"""rsl_rl: the vector env as its ``VecEnv``."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium.spaces import flatdim
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from rsl_rl.env import VecEnv
from tensordict import TensorDict

from dappo_batch.envs import DamageVectorEnv
from dappo_batch.interop import check_envs

__all__ = ["RslRlVecEnv"]


class RslRlVecEnv(VecEnv):
    """A `DamageVectorEnv` as a ``VecEnv`` of rsl_rl 5.

    Observations have the groups ``"robot"`` and, if the envs observe damage, ``"damage_code"``. The setting
    ``obs_groups`` of the runner assigns them to networks; the damage code is hidden only from the policy by
    ``{"actor": ["robot"], "critic": ["robot", "damage_code"]}``.

    Parameters
    ----------
    envs : DamageVectorEnv
        Created with ``autoreset="disabled"``, because the runner also ends episodes:
        ``init_at_random_ep_len`` shortens the first ones.
    device : str
        Device of the tensors.

    Attributes
    ----------
    envs : DamageVectorEnv
        The same object.
    episode_length_buf : torch.Tensor
        Steps of the running episodes, int64 [N].

    Raises
    ------
    ConfigError
        If `envs` have another autoreset mode or return views.
    """

    def __init__(self, envs: DamageVectorEnv, *, device: str = "cpu") -> None:
        check_envs(envs, AutoresetMode.DISABLED)
        self.envs = envs
        self.num_envs = envs.num_envs
        self.num_actions = flatdim(envs.single_action_space)
        self.max_episode_length = envs.max_episode_steps
        self.episode_length_buf = torch.zeros(envs.num_envs, dtype=torch.int64, device=device)
        self.device = device
        self.cfg = {"robot": envs.table.robot.name, "num_envs": envs.num_envs}
        obs, _ = envs.reset()
        self._obs = self._grouped(obs)

    def get_observations(self) -> TensorDict:
        """Return the current observations by group, each float32 [N, …]."""
        return self._obs

    def step(self, actions: torch.Tensor) -> tuple[TensorDict, torch.Tensor, torch.Tensor, dict[str, Any]]:
        """Advance every env by one step, and reset the envs whose episodes ended.

        Parameters
        ----------
        actions : torch.Tensor
            Shape [N, A]; values beyond -1 and 1 are clipped.

        Returns
        -------
        obs : TensorDict
            Observations; where an episode ended, the first one of the next episode.
        rewards : torch.Tensor
            float32 [N].
        dones : torch.Tensor
            Terminated or truncated, bool [N].
        extras : dict
            ``time_outs``: truncated and not terminated, bool [N].
        """
        obs, rewards, terminated, truncated, _ = self.envs.step(actions.cpu().numpy())
        self.episode_length_buf += 1
        truncated |= (self.episode_length_buf >= self.max_episode_length).cpu().numpy()
        dones = terminated | truncated
        ended = self._tensor(dones)
        if dones.any():
            obs, _ = self.envs.reset(options={"reset_mask": dones})
            self.episode_length_buf[ended] = 0
        self._obs = self._grouped(obs)
        extras = {"time_outs": self._tensor(truncated & ~terminated)}
        return self._obs, self._tensor(rewards.astype(np.float32)), ended, extras

    def close(self) -> None:
        """Free the native memory."""
        self.envs.close()

    def _grouped(self, obs: NDArray[np.float32]) -> TensorDict:
        rows = self._tensor(obs)
        code_length = self.envs.table.space.code_length if self.envs.observe_damage else 0
        robot_length = rows.shape[1] - code_length
        groups = {"robot": rows[:, :robot_length]}
        if code_length:
            groups["damage_code"] = rows[:, robot_length:]
        return TensorDict(groups, batch_size=[self.num_envs], device=self.device)

    def _tensor(self, array: NDArray[Any]) -> torch.Tensor:
        return torch.from_numpy(array).to(self.device)
