"""Sizes of the check: realistic ones for a GPU, the same in miniature for a CPU."""

from __future__ import annotations

from dataclasses import dataclass

from dappo_batch.model import Physics

__all__ = ["SCALES", "Scale"]


@dataclass(frozen=True)
class Scale:
    """Sizes of one check.

    Attributes
    ----------
    device : str
        Name of the device in Warp.
    num_envs : tuple of int
        Timed batch sizes.
    robots, integrators : tuple of str
        Timed robots and integrators.
    horizon : int
        Env steps of a timed rollout.
    rollouts : int
        Timed rollouts.
    hidden : tuple of int
        Hidden layers of the policy.
    training : tuple of str
        Arguments of ``dappo-batch train``.
    forward_reward : float
        Forward reward at which the training is stopped.
    tests : str
        Selected tests, an argument of pytest's ``-k``; empty for all.
    """

    device: str
    num_envs: tuple[int, ...]
    robots: tuple[str, ...]
    integrators: tuple[Physics, ...]
    horizon: int
    rollouts: int
    hidden: tuple[int, ...]
    training: tuple[str, ...]
    forward_reward: float
    tests: str


SCALES = {
    "cuda": Scale(
        device="cuda:0",
        num_envs=(1024, 4096, 16384, 65536),
        robots=("ant", "hexapod"),
        integrators=("euler", "rk4"),
        horizon=16,
        rollouts=3,
        hidden=(100, 200, 100),
        training=("--envs", "4096", "--steps", "20000000", "--physics", "euler"),
        forward_reward=1500.0,
        tests="",
    ),
    "warp-cpu": Scale(
        device="cpu",
        num_envs=(2, 4),
        robots=("ant",),
        integrators=("euler",),
        horizon=2,
        rollouts=1,
        hidden=(8,),
        training=(
            *("--envs", "4", "--steps", "128", "--physics", "euler"),
            *("--set", "horizon=16", "ppo.hidden=[8]", "damage.max_damaged_limbs=0", "evaluation.episodes=1"),
        ),
        forward_reward=1500.0,
        tests="philox",
    ),
}
