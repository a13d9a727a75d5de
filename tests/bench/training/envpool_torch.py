"""PPO as a plain loop in PyTorch over EnvPool, as a program of a worker."""

from __future__ import annotations

import importlib
import importlib.metadata
import time
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .task import Task, pass_flops
from .torch_threads import use_fastest

__all__ = ["EnvPoolPpo", "Rollout", "advantages"]

Torch: TypeAlias = Any  # its types are unknown where it is not installed

_ENV_ID = "Ant-v5"
_MAX_GRADIENT_NORM = 0.5
_ADAM_EPSILON = 1e-5
_INITIAL_LOG_STD = -0.5


@dataclass(frozen=True, eq=False)
class Rollout:
    """T steps of N envs.

    Attributes
    ----------
    obs : array of shape [T, N, obs_dim]
        Observations, float32.
    actions : array of shape [T, N, action_dim]
        Actions as drawn, before they are clipped.
    log_probs, rewards : array of shape [T, N]
        Logarithmic densities of the actions, and rewards.
    values : array of shape [T + 1, N]
        Values of the observations, including those after the last step.
    terminated, ended : array of shape [T, N]
        Whether the step terminated its episode, and whether it terminated or truncated it.
    is_step : array of shape [T, N]
        False if the call only reset the env, which EnvPool does in the call after the end of an episode.
    """

    obs: NDArray[np.float32]
    actions: NDArray[np.float32]
    log_probs: NDArray[np.float32]
    rewards: NDArray[np.float32]
    values: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    ended: NDArray[np.bool_]
    is_step: NDArray[np.bool_]

    @classmethod
    def empty(cls, horizon: int, num_envs: int, obs_dim: int, action_dim: int) -> Rollout:
        """Return uninitialised buffers."""
        shape = (horizon, num_envs)
        return cls(
            obs=np.empty((*shape, obs_dim), np.float32),
            actions=np.empty((*shape, action_dim), np.float32),
            log_probs=np.empty(shape, np.float32),
            rewards=np.empty(shape, np.float32),
            values=np.empty((horizon + 1, num_envs), np.float32),
            terminated=np.empty(shape, np.bool_),
            ended=np.empty(shape, np.bool_),
            is_step=np.empty(shape, np.bool_),
        )


def advantages(rollout: Rollout, gamma: float, gae_lambda: float) -> NDArray[np.float32]:
    """Return generalised advantage estimates (Schulman et al., 2016), [T, N].

    Truncated episodes are bootstrapped with the value of their last observation.
    """
    following = np.where(rollout.terminated, 0.0, rollout.values[1:])
    errors = rollout.rewards + gamma * following - rollout.values[:-1]
    estimates = np.empty_like(rollout.rewards)
    later = np.zeros(rollout.rewards.shape[1])
    for step in reversed(range(len(errors))):
        later = errors[step] + gamma * gae_lambda * np.where(rollout.ended[step], 0.0, later)
        estimates[step] = later
    return estimates


class EnvPoolPpo:
    """PPO with networks of PyTorch, envs of EnvPool, and the sizes of the task."""

    def __init__(self, task: Task) -> None:
        self._task = task
        self._torch: Torch = importlib.import_module("torch")
        self._torch.manual_seed(task.seed)
        envpool: Any = importlib.import_module("envpool")
        self._envs = envpool.make(
            _ENV_ID, env_type="gymnasium", num_envs=task.num_envs, num_threads=task.threads, seed=task.seed
        )
        self._obs_dim, self._action_dim = (
            space.shape[0] for space in (self._envs.observation_space, self._envs.action_space)
        )
        self._policy, self._value = self._mlp(self._action_dim), self._mlp(1)
        self._log_std = self._torch.full((self._action_dim,), _INITIAL_LOG_STD, requires_grad=True)
        self._parameters = [*self._policy.parameters(), self._log_std, *self._value.parameters()]
        self._adam = self._torch.optim.Adam(self._parameters, lr=task.learning_rate, eps=_ADAM_EPSILON)
        self._obs = self._envs.reset()[0].astype(np.float32)
        self._ended = np.zeros(task.num_envs, np.bool_)
        versions = [f"{name} {importlib.metadata.version(name)}" for name in ("envpool", "torch")]
        threads = use_fastest(task.threads, lambda: self.answer(1))
        self.note = f"{versions[0]}, {versions[1]}; {threads}"

    def _sizes(self, outputs: int) -> list[int]:
        return [self._obs_dim, *self._task.hidden, outputs]

    def _mlp(self, outputs: int) -> Torch:
        nn, sizes, layers = self._torch.nn, self._sizes(outputs), []
        for inputs, units in pairwise(sizes[:-1]):
            layers += [nn.Linear(inputs, units), nn.Tanh()]
        return nn.Sequential(*layers, nn.Linear(sizes[-2], outputs))

    def _log_prob(self, actions: Torch, means: Torch) -> Torch:
        """Return the logarithmic densities of `actions` [B, A] around `means` [B, A], [B]."""
        return self._torch.distributions.Normal(means, self._log_std.exp()).log_prob(actions).sum(-1)

    def collect(self) -> Rollout:
        """Collect a rollout of `horizon` steps."""
        torch, task = self._torch, self._task
        rollout = Rollout.empty(task.horizon, task.num_envs, self._obs_dim, self._action_dim)
        with torch.no_grad():
            for step in range(task.horizon):
                obs = torch.from_numpy(self._obs)
                means = self._policy(obs)
                actions = torch.normal(means, self._log_std.exp().expand_as(means))
                rollout.obs[step], rollout.actions[step] = self._obs, actions.numpy()
                rollout.log_probs[step] = self._log_prob(actions, means).numpy()
                rollout.values[step] = self._value(obs)[:, 0].numpy()
                rollout.is_step[step] = ~self._ended
                self._step(rollout, step)
            rollout.values[-1] = self._value(torch.from_numpy(self._obs))[:, 0].numpy()
        return rollout

    def _step(self, rollout: Rollout, step: int) -> None:
        actions = np.clip(rollout.actions[step], -1.0, 1.0).astype(np.float64)
        obs, rollout.rewards[step], terminated, truncated, _ = self._envs.step(actions)
        self._obs, self._ended = obs.astype(np.float32), terminated | truncated
        rollout.terminated[step], rollout.ended[step] = terminated, self._ended

    def update(self, rollout: Rollout) -> int:
        """Train both networks on a rollout; return the number of rows of all epochs."""
        torch, task = self._torch, self._task
        estimates = advantages(rollout, task.gamma, task.gae_lambda)
        returns = estimates + rollout.values[:-1]
        columns = (rollout.obs, rollout.actions, rollout.log_probs, estimates, returns)
        batch = [torch.from_numpy(column[rollout.is_step]) for column in columns]
        for _ in range(task.epochs):
            for rows in torch.randperm(len(batch[0])).split(task.minibatch):
                loss = self._loss(*(column[rows] for column in batch))
                self._adam.zero_grad()
                loss.backward()
                torch.nn.utils.clip_grad_norm_(self._parameters, _MAX_GRADIENT_NORM)
                self._adam.step()
        return task.epochs * len(batch[0])

    def _loss(self, obs: Torch, actions: Torch, log_probs: Torch, estimates: Torch, returns: Torch) -> Torch:
        """Return the clipped surrogate's loss plus half the mean squared error of the value net."""
        clip = self._task.clip_range
        estimates = (estimates - estimates.mean()) / (estimates.std(correction=0) + 1e-8)
        ratio = (self._log_prob(actions, self._policy(obs)) - log_probs).exp()
        surrogate = self._torch.minimum(ratio * estimates, ratio.clamp(1.0 - clip, 1.0 + clip) * estimates)
        return 0.5 * (self._value(obs)[:, 0] - returns).square().mean() - surrogate.mean()

    def answer(self, number: float) -> dict[str, Any]:
        """Train for `number` iterations; returns the fields of a `Sample`."""
        env_steps, rows, rollout_seconds, update_seconds = 0, 0, 0.0, 0.0
        for _ in range(int(number)):
            start = time.perf_counter()
            rollout = self.collect()
            collected = time.perf_counter()
            rows += self.update(rollout)
            env_steps += int(rollout.is_step.sum())
            rollout_seconds += collected - start
            update_seconds += time.perf_counter() - collected
        row_flops = pass_flops(self._sizes(self._action_dim)) + pass_flops(self._sizes(1))
        return {
            "iterations": int(number),
            "env_steps": env_steps,
            "rollout_seconds": rollout_seconds,
            "update_seconds": update_seconds,
            "update_flops": float(rows * row_flops),
        }

    def close(self) -> None:
        """Free processes and memory."""
        self._envs.close()
