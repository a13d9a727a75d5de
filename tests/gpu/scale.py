"""Sizes of the check: realistic ones for a GPU, the same in miniature without one."""

from __future__ import annotations

from dataclasses import dataclass

from dappo_batch.model import Physics

__all__ = ["FULL", "SMALL", "Scale"]


@dataclass(frozen=True)
class Scale:
    """Sizes of one check.

    Attributes
    ----------
    robots : tuple of tuple
        Robots and integrators that the GPU engine is timed with; ``None`` is the robot's own.
    num_envs : tuple of int
        Batch sizes that the GPU engine is timed with.
    seconds : float
        Least length of a timed sample, s.
    states : int
        States of each damage class in which the GPU engine is compared with MuJoCo.
    parity : str
        Selected tests of the GPU engine, an argument of pytest's ``-k``; empty for all.
    healthy, dappo : tuple of str
        Arguments of ``dappo-batch train``: the healthy Ant, and DA-PPO.
    forward_reward : float
        Forward reward at which the training of the healthy Ant is stopped.
    warp : tuple of str
        Name of mujoco_warp's device for ``dappo-batch`` and in Warp.
    warp_robots : tuple of str
        Robots that mujoco_warp is timed and compared with.
    warp_envs : int
        Batch size that it is timed with.
    integrators : tuple of str
        Integrators that it is timed with.
    iterations : tuple of int
        Most iterations of its solver that it is timed with.
    horizon : int
        Env steps of a timed rollout.
    rollouts : int
        Timed rollouts.
    hidden : tuple of int
        Hidden layers of the policy.
    tests : str
        Selected tests of the kernels, an argument of pytest's ``-k``; empty for all.
    """

    robots: tuple[tuple[str, Physics | None], ...]
    num_envs: tuple[int, ...]
    seconds: float
    states: int
    parity: str
    healthy: tuple[str, ...]
    dappo: tuple[str, ...]
    forward_reward: float
    warp: tuple[str, str]
    warp_robots: tuple[str, ...]
    warp_envs: int
    integrators: tuple[Physics, ...]
    iterations: tuple[int, ...]
    horizon: int
    rollouts: int
    hidden: tuple[int, ...]
    tests: str


FULL = Scale(
    robots=(("ant", "rk4"), ("ant", "euler"), ("go1", None)),
    num_envs=(1024, 4096, 16384, 65536),
    seconds=1.0,
    states=4,
    parity="",
    healthy=("--healthy", "--envs", "4096", "--steps", "400000000"),
    dappo=("--envs", "4096", "--steps", "50000000"),
    forward_reward=1500.0,
    warp=("cuda", "cuda:0"),
    warp_robots=("ant", "hexapod"),
    warp_envs=4096,
    integrators=("euler", "rk4"),
    iterations=(100, 10),
    horizon=16,
    rollouts=3,
    hidden=(100, 200, 100),
    tests="",
)

_FEW = (
    *("--envs", "4", "--steps", "128", "--physics", "euler"),
    *("--set", "horizon=16", "ppo.hidden=[8]", "damage.max_damaged_limbs=0", "evaluation.episodes=1"),
)

SMALL = Scale(
    robots=(("ant", "euler"),),
    num_envs=(2, 4),
    seconds=0.05,
    states=1,
    parity="the_same_bits and not resumed",
    healthy=("--healthy", *_FEW),
    dappo=_FEW,
    forward_reward=1500.0,
    warp=("warp-cpu", "cpu"),
    warp_robots=("ant",),
    warp_envs=4,
    integrators=("euler",),
    iterations=(100,),
    horizon=2,
    rollouts=1,
    hidden=(8,),
    tests="philox",
)
