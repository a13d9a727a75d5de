"""Stable-Baselines3's PPO, as a program of a worker."""

from __future__ import annotations

import importlib
import importlib.metadata
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from .task import Task, pass_flops
from .torch_threads import use_fastest

__all__ = ["StableBaselinesPpo"]

_PACKAGES = ("stable-baselines3", "torch", "gymnasium", "mujoco")
_REPEATS = 3  # the best counts, so that an interruption of one does not decide
_TIMED_STEPS = 40


class StableBaselinesPpo:
    """``PPO("MlpPolicy", make_vec_env("Ant-v5"))`` with the sizes of the task.

    Envs run in one process or in one process each, whichever is faster on this machine.
    """

    def __init__(self, task: Task) -> None:
        sb3 = importlib.import_module("stable_baselines3")
        torch = importlib.import_module("torch")
        self._task = task
        self._envs, chosen = _fastest_envs(task)
        self._ppo: Any = sb3.PPO(
            "MlpPolicy",
            self._envs,
            n_steps=task.horizon,
            batch_size=task.minibatch,
            n_epochs=task.epochs,
            gamma=task.gamma,
            gae_lambda=task.gae_lambda,
            clip_range=task.clip_range,
            learning_rate=task.learning_rate,
            policy_kwargs={
                "net_arch": {"pi": list(task.hidden), "vf": list(task.hidden)},
                "activation_fn": torch.nn.Tanh,
            },
            seed=task.seed,
            device="cpu",
        )
        self._seconds = {"collect_rollouts": 0.0, "train": 0.0}
        for name in self._seconds:
            setattr(self._ppo, name, self._timed(name))
        inputs, outputs = self._envs.observation_space.shape[0], self._envs.action_space.shape[0]
        nets = ([inputs, *task.hidden, outputs], [inputs, *task.hidden, 1])
        self._row_flops = sum(pass_flops(sizes) for sizes in nets)
        versions = [f"{name} {importlib.metadata.version(name)}" for name in _PACKAGES]
        threads = use_fastest(task.threads, lambda: self.answer(1))
        self.note = f"{', '.join(versions)}; {chosen}; {threads}"

    def _timed(self, name: str) -> Callable[..., Any]:
        method = getattr(self._ppo, name)

        def timed(*arguments: object, **options: object) -> object:
            start = time.perf_counter()
            outcome = method(*arguments, **options)
            self._seconds[name] += time.perf_counter() - start
            return outcome

        return timed

    def answer(self, number: float) -> dict[str, Any]:
        """Train for `number` iterations; returns the fields of a `Sample`."""
        self._seconds.update(dict.fromkeys(self._seconds, 0.0))
        before = self._ppo.num_timesteps
        self._ppo.learn(int(number) * self._task.batch, reset_num_timesteps=before == 0)
        steps = self._ppo.num_timesteps - before
        return {
            "iterations": int(number),
            "env_steps": steps,
            "rollout_seconds": self._seconds["collect_rollouts"],
            "update_seconds": self._seconds["train"],
            "update_flops": float(steps * self._task.epochs * self._row_flops),
        }

    def close(self) -> None:
        """Free processes and memory."""
        self._envs.close()


def _fastest_envs(task: Task) -> tuple[Any, str]:
    """Time both kinds of vectorised envs; return the faster one and a remark on the choice."""
    make = importlib.import_module("stable_baselines3.common.env_util").make_vec_env
    kinds = importlib.import_module("stable_baselines3.common.vec_env")
    # Forked, because the library's default imports PyTorch in each of the processes.
    candidates: dict[str, dict[str, str]] = {"SubprocVecEnv": {"start_method": "fork"}, "DummyVecEnv": {}}
    made = {
        name: make(
            "Ant-v5", task.num_envs, seed=task.seed, vec_env_cls=getattr(kinds, name), vec_env_kwargs=options
        )
        for name, options in candidates.items()
    }
    rates = dict.fromkeys(made, 0.0)
    for name in [*made] * _REPEATS:
        rates[name] = max(rates[name], _rate(made[name], task))
    best = max(rates, key=lambda name: rates[name])
    for name, envs in made.items():
        if name != best:
            envs.close()
    found = ", ".join(f"{name} {rate:.0f}" for name, rate in rates.items())
    return made[best], f"{best}, the faster one (env steps/s: {found})"


def _rate(envs: Any, task: Task) -> float:  # noqa: ANN401 - a class of a library that may be absent
    """Return the env steps per second with random actions."""
    width = envs.action_space.shape[0]
    actions = np.random.default_rng(task.seed).uniform(-1.0, 1.0, (_TIMED_STEPS, task.num_envs, width))
    envs.reset()
    envs.step(actions[0].astype(np.float32))
    start = time.perf_counter()
    for batch in actions.astype(np.float32):
        envs.step(batch)
    return _TIMED_STEPS * task.num_envs / (time.perf_counter() - start)
