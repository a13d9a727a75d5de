"""The trainers of ``python -m tests.bench.training``, as seen by the measuring process."""

from __future__ import annotations

import tomllib
from abc import abstractmethod
from dataclasses import dataclass
from typing import ClassVar

from dappo_batch._core import SimulationError
from dappo_batch.bench.simulators import Unavailable

from .. import commands, rounds
from ..commands import TrainingFailed, TrainingRun
from ..entry import WorkerEntry
from .task import Task, pass_flops

__all__ = [
    "AsConfigured",
    "EnvPoolTorch",
    "Lanes",
    "Mujoco",
    "Sample",
    "StableBaselines",
    "Symmetric",
    "Trainer",
]


@dataclass(frozen=True)
class Sample:
    """Some iterations of one trainer.

    Attributes
    ----------
    iterations : int
        Iterations, each a rollout and an update.
    env_steps : int
        Env steps over all envs.
    rollout_seconds, update_seconds : float
        Elapsed time of all iterations.
    update_flops : float
        Minimum number of floating-point operations of their updates, see `pass_flops`.
    """

    iterations: int
    env_steps: int
    rollout_seconds: float
    update_seconds: float
    update_flops: float

    @property
    def seconds(self) -> float:
        """Elapsed time."""
        return self.rollout_seconds + self.update_seconds

    @property
    def rate(self) -> float:
        """Env steps of complete training per second."""
        return self.env_steps / self.seconds


class Trainer(rounds.Trainer[Sample]):
    """A training library or setting.

    Attributes
    ----------
    physics : str
        The simulator of `dappo_batch.bench` whose env steps per second bound its rollout.
    num_envs, horizon : int
        Size of its batch.
    """

    physics: ClassVar[str] = "mj_step"
    num_envs: int
    horizon: int

    def __init__(self, task: Task) -> None:
        self.require()
        self.num_envs, self.horizon = task.num_envs, task.horizon


# A run ends with an evaluation, which is not measured and is shorter with fewer damage classes. The training
# uses only the healthy class and does not change.
_SHORT_END = ("evaluation.episodes=1", "damage.max_damaged_limbs=1")


class Ours(Trainer):
    """``dappo-batch train``, one process for each sample; its first iteration is not counted."""

    def __init__(self, task: Task) -> None:
        super().__init__(task)
        self._threads = task.threads
        self._arguments = ["--robot", "ant", "--healthy", "--reward", "gym", "--threads", str(task.threads)]
        self._arguments += [*self.options(task), "--set", *self.settings(task), *_SHORT_END]
        try:
            config = tomllib.loads(commands.command_line(["config", *self._arguments], task.threads))
        except TrainingFailed as error:
            raise Unavailable(str(error)) from error
        self.num_envs, self.horizon = config["env"]["num_envs"], config["horizon"]

    @abstractmethod
    def options(self, task: Task) -> list[str]:
        """Arguments of ``train`` that differ between these trainers."""

    def settings(self, task: Task) -> list[str]:
        """Values of ``--set``.

        The value net is trained on the current and the previous batch, so half the epochs give it as many
        rows as the policy. No epoch is skipped for a large KL divergence.
        """
        return [
            "ppo.preset=paper",
            f"horizon={task.horizon}",
            f"seed={task.seed}",
            f"ppo.hidden={list(task.hidden)}",
            f"ppo.gamma={task.gamma}",
            f"ppo.gae_lambda={task.gae_lambda}",
            f"ppo.clip_range={task.clip_range}",
            f"ppo.learning_rate={task.learning_rate}",
            f"ppo.epochs={task.epochs}",
            f"ppo.value_epochs={task.epochs // 2}",
            f"ppo.minibatch_size={task.minibatch}",
            f"ppo.value_minibatch_size={task.minibatch}",
            "ppo.kl_stop=1e9",
        ]

    def train(self, amount: int) -> Sample:
        """Train for `amount` iterations, not counting a warm-up."""
        steps = (amount + 1) * self.num_envs * self.horizon
        try:
            run = commands.train([*self._arguments, f"total_steps={steps}"], self._threads)
            return sample_of(run)
        except TrainingFailed as error:
            raise SimulationError(f"{self.key}: {error}") from error


def sample_of(run: TrainingRun) -> Sample:
    """Summarise a run without its first iteration, which allocates memory and has no previous batch."""
    rows, config, shapes = run.metrics[1:], run.config, run.learner
    if not rows:
        raise TrainingFailed("the run has only one iteration, which is the warm-up")
    try:
        batch = int(config["env"]["num_envs"]) * int(config["horizon"])
        inputs, hidden, outputs = int(shapes["obs_dim"]), list(shapes["hidden"]), int(shapes["action_dim"])
        policy_rows = batch * sum(int(row["epochs_run"]) for row in rows)
        value_rows = 2 * batch * int(config["ppo"]["value_epochs"]) * len(rows)
        policy, value = pass_flops([inputs, *hidden, outputs]), pass_flops([inputs, *hidden, 1])
        # Networks that are their own mirror images take half the products.
        products = 0.5 if config["ppo"].get("symmetry", False) is True else 1.0
        return Sample(
            iterations=len(rows),
            env_steps=int(rows[-1]["env_steps"]) - int(run.metrics[0]["env_steps"]),
            rollout_seconds=sum(float(row["rollout_seconds"]) for row in rows),
            update_seconds=sum(float(row["update_seconds"]) for row in rows),
            update_flops=products * (policy_rows * policy + value_rows * value),
        )
    except KeyError as error:
        raise TrainingFailed(f"the run folder lacks {error}") from error


class Lanes(Ours):
    """``dappo-batch train`` with the lane engine."""

    key = "ours lanes"
    about = "dappo-batch train --backend lanes"
    physics = "lanes f32"

    def options(self, task: Task) -> list[str]:
        """Arguments of ``train`` that differ between these trainers."""
        return ["--envs", str(task.num_envs), "--backend", "lanes"]


class Symmetric(Lanes):
    """The same with networks that are their own mirror images."""

    key = "ours lanes, symmetric"
    about = "dappo-batch train --backend lanes with left-right symmetric networks, as by default"

    def settings(self, task: Task) -> list[str]:
        """Values of ``--set``."""
        return [*super().settings(task), "ppo.symmetry=true"]


class Mujoco(Ours):
    """``dappo-batch train`` with libmujoco."""

    key = "ours mujoco"
    about = "dappo-batch train --backend mujoco"

    def options(self, task: Task) -> list[str]:
        """Arguments of ``train`` that differ between these trainers."""
        return ["--envs", str(task.num_envs), "--backend", "mujoco"]


class AsConfigured(Ours):
    """``dappo-batch train`` with the default sizes."""

    key = "ours lanes, as configured"
    about = "dappo-batch train --backend lanes with the batch of configs/ant.toml: different batch and epochs"
    physics = "lanes f32"

    def options(self, task: Task) -> list[str]:
        """Arguments of ``train`` that differ between these trainers."""
        return ["--backend", "lanes"]

    def settings(self, task: Task) -> list[str]:
        """Values of ``--set``."""
        return [f"seed={task.seed}"]


class Peer(WorkerEntry, Trainer):
    """A training of another library."""

    def __init__(self, task: Task) -> None:
        super().__init__(task)
        self.start(task)
        try:
            self.train(1)  # the first iteration allocates and loads, and is not timed
        except SimulationError as error:
            raise Unavailable(str(error)) from error

    def train(self, amount: int) -> Sample:
        """Train for `amount` iterations, not counting a warm-up."""
        return Sample(**self.ask(amount))


class StableBaselines(Peer):
    """Stable-Baselines3's PPO on Gymnasium's Ant."""

    key = "sb3"
    about = "Stable-Baselines3 PPO, MlpPolicy, Gymnasium's Ant-v5"
    packages: ClassVar[dict[str, str]] = {"stable_baselines3": "stable-baselines3", "torch": "torch"}
    program = "tests.bench.training.stable_baselines:StableBaselinesPpo"


class EnvPoolTorch(Peer):
    """A plain PPO loop in PyTorch on EnvPool's Ant."""

    key = "envpool + torch"
    about = "a plain PyTorch loop over EnvPool's Ant-v5, synchronous"
    packages: ClassVar[dict[str, str]] = {"envpool": "envpool", "torch": "torch"}
    program = "tests.bench.training.envpool_torch:EnvPoolPpo"
