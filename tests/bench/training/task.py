"""The training that every contender does: sizes and settings of PPO, and what its update costs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

__all__ = ["Task", "pass_flops"]


@dataclass(frozen=True)
class Task:
    """Proximal policy optimisation on the healthy Ant with Gymnasium's reward.

    Attributes
    ----------
    threads : int
        Threads, and where the system can do that cores, of a contender.
    num_envs, horizon : int
        Environments N, and env steps T of each in one iteration; the batch has N · T rows.
    epochs : int
        Passes of the policy and of the value net over the batch.
    minibatch_rows : int
        Rows of a minibatch of a batch that has as many.
    hidden : sequence of int
        Units of the tanh layers; the policy and the value net share none.
    gamma, gae_lambda : float
        Discount, and λ of generalised advantage estimation.
    clip_range : float
        ε of the clipped surrogate.
    learning_rate : float
        Adam's.
    seed : int
        Seed of envs, weights and shuffles.
    """

    threads: int
    num_envs: int = 16
    horizon: int = 512
    epochs: int = 10
    minibatch_rows: int = 2048
    hidden: Sequence[int] = (100, 200, 100)
    gamma: float = 0.995
    gae_lambda: float = 0.98
    clip_range: float = 0.2
    learning_rate: float = 3e-4
    seed: int = 0

    @property
    def batch(self) -> int:
        """Env steps of one iteration, over all envs."""
        return self.num_envs * self.horizon

    @property
    def minibatch(self) -> int:
        """Rows of a minibatch."""
        return min(self.minibatch_rows, self.batch)


def pass_flops(sizes: Sequence[int]) -> int:
    """Return the floating-point operations of one row's pass through an MLP, forwards and backwards.

    A layer of m inputs and n outputs is in three products of matrices, each of m n multiplications and as
    many additions a row::

        forwards                        y = W x       2 m n
        gradient of the weights         dW = dy xᵀ    2 m n
        gradient of the inputs          dx = Wᵀ dy    2 m n, and 0 in the first layer: nobody needs it

    Over all layers that is 6 Σ m n less 2 m n of the first. Biases, tanh, the loss and Adam are left out:
    their work grows with m or n alone, or is done once a minibatch and not for each row.

    An update that passes r rows through the policy and v rows through the value net, epochs included, takes
    r · policy + v · value operations.

    Parameters
    ----------
    sizes : sequence of int
        Inputs, hidden units…, outputs.
    """
    products = [inputs * outputs for inputs, outputs in pairwise(sizes)]
    return 6 * sum(products) - 2 * products[0]
