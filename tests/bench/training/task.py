"""The training task: sizes and settings of PPO, and the number of operations of its update."""

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
        Threads of a trainer, and cores if the system supports a limit.
    num_envs, horizon : int
        Environments N, and env steps T of each in one iteration; the batch has N · T rows.
    epochs : int
        Passes of the policy and of the value net over the batch.
    minibatch_rows : int
        Rows of a minibatch; at most those of the batch.
    hidden : sequence of int
        Units of the tanh layers; the policy and the value net share no layers.
    gamma, gae_lambda : float
        Discount, and λ of generalised advantage estimation.
    clip_range : float
        ε of the clipped surrogate.
    learning_rate : float
        Learning rate of Adam.
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
    """Return the floating-point operations of a forward and backward pass of one row through an MLP.

    A layer with m inputs and n outputs takes three matrix products, each with m n multiplications and
    additions for one row::

        forward                         y = W x       2 m n
        gradient of the weights         dW = dy xᵀ    2 m n
        gradient of the inputs          dx = Wᵀ dy    2 m n, and 0 in the first layer

    Over all layers that is 6 Σ m n minus 2 m n of the first. Biases, tanh, the loss and Adam are not counted:
    their work is proportional to m or n alone, or is done once for each minibatch.

    An update that passes r rows through the policy and v rows through the value net, epochs included, takes
    r · policy + v · value operations.

    Parameters
    ----------
    sizes : sequence of int
        Inputs, hidden units…, outputs.
    """
    products = [inputs * outputs for inputs, outputs in pairwise(sizes)]
    return 6 * sum(products) - 2 * products[0]
