"""The training task: the network of the diagnoser, its data, and the number of operations of a sample."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from ..training.task import pass_flops

__all__ = ["Task"]


@dataclass(frozen=True)
class Task:
    """The network of Verma et al. (2019), section III, on pairs of a damaged robot and its healthy twin.

    Attributes
    ----------
    threads : int
        Threads of a trainer, and cores if the system supports a limit.
    minibatch : int
        Samples of a minibatch; an epoch is split into equal ones as close to this size as possible.
    data : str
        Folder of the dataset, which has one more rollout than `rollouts`, for validation.
    rollouts : int
        Rollouts of the training data; each has a sample of every damage class.
    classes : int
        Damage classes C.
    timesteps : int
        Steps of a window, T.
    inputs : int
        Length of an observation, O; inputs are the twin's minus the damaged robot's (method B).
    embedding, lstm : int
        Widths of the linear embedding of a step and of the LSTM's hidden state.
    hidden : sequence of int
        Widths of the dense layers, each with ReLU and dropout.
    dropout : float
        Probability that a unit is dropped in training.
    learning_rate : float
        Learning rate of Adam.
    seed : int
        Seed of weights, order of samples and dropout.
    """

    threads: int
    minibatch: int
    data: str
    rollouts: int
    classes: int
    timesteps: int
    inputs: int
    embedding: int = 512
    lstm: int = 32
    hidden: Sequence[int] = (256, 128, 64)
    dropout: float = 0.1
    learning_rate: float = 1e-3
    seed: int = 0

    @property
    def samples(self) -> int:
        """Samples of an epoch."""
        return self.rollouts * self.classes

    @property
    def steps(self) -> int:
        """Minibatches of an epoch, as many as in ``dappo-batch diagnose train``."""
        return max(1, int(self.samples / self.minibatch + 0.5))

    @property
    def plain_flops(self) -> float:
        """Floating-point operations of a sample's forward and backward pass, layer by layer.

        At each of the T steps two linear layers map the observation to the embedding and the embedding to the
        four gates; see `pass_flops`. The recurrence and the dense layers are added to these.
        """
        gates = 4 * self.lstm
        return float(self.timesteps * pass_flops([self.inputs, self.embedding, gates]) + self._behind_gates)

    @property
    def folded_flops(self) -> float:
        """The same with the embedding folded into the gates, the smallest known number.

        The two linear layers follow each other directly, so their product, computed once for each minibatch,
        maps an observation to the gates. It has O + 1 rows, one of them for the bias of the embedding, and
        the gradients of its two factors follow from its own: three products of 2 (O + 1) E · 4 H operations.
        """
        gates = 4 * self.lstm
        product = 6 * (self.inputs + 1) * self.embedding * gates
        window = self.timesteps * pass_flops([self.inputs, gates]) + self._behind_gates
        return window + product * self.steps / self.samples

    @property
    def _behind_gates(self) -> int:
        """Operations of the recurrence, which the first step does not have, and of the dense layers.

        All of their inputs need a gradient, so each weight takes 6 operations.
        """
        recurrent = (self.timesteps - 1) * self.lstm * 4 * self.lstm
        sizes = (self.lstm, *self.hidden, self.classes)
        return 6 * (recurrent + sum(inputs * outputs for inputs, outputs in pairwise(sizes)))
