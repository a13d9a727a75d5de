"""How large a check is: a GPU gets real work, a CPU the same in miniature."""

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
        The device as Warp names it.
    num_envs : tuple of int
        Batch sizes that are timed.
    robots, integrators : tuple of str
        What is timed.
    horizon : int
        Env steps of a timed rollout.
    rollouts : int
        Timed rollouts.
    hidden : tuple of int
        Hidden layers of the policy.
    training : tuple of str
        Arguments of ``dappo-batch train``.
    forward_reward : float
        What the training is to reach; it is stopped there.
    tests : str
        Tests that run, as pytest's ``-k`` has it; empty for all.
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
