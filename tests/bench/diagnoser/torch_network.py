"""The network of the diagnoser and its training in PyTorch, as programs of a worker."""

from __future__ import annotations

import importlib
import importlib.metadata
import time
from itertools import islice, pairwise
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..autotune import fastest
from .task import Task
from .windows import Windows

__all__ = ["FoldedNetwork", "FoldedTorchDiagnoser", "Network", "TorchDiagnoser"]

Torch: TypeAlias = Any  # its types are unknown where it is not installed

_TIMED_STEPS = 8


class Network:
    """A linear embedding of every step, an LSTM, dense layers with ReLU and dropout, a linear head.

    Attributes
    ----------
    embedding, lstm, dense : torch.nn.Module
        Its parts; `dense` includes the head.
    """

    def __init__(self, task: Task) -> None:
        self._torch: Torch = importlib.import_module("torch")
        nn, sizes, layers = self._torch.nn, (task.lstm, *task.hidden), []
        self.embedding = nn.Linear(task.inputs, task.embedding)
        self.lstm = nn.LSTM(task.embedding, task.lstm, batch_first=True)
        for inputs, units in pairwise(sizes):
            layers += [nn.Linear(inputs, units), nn.ReLU(), nn.Dropout(task.dropout)]
        self.dense = nn.Sequential(*layers, nn.Linear(sizes[-1], task.classes))
        self._draw()

    def _draw(self) -> None:
        """Draw the weights as ``dappo-batch diagnose train`` does, so that the losses can be compared."""
        init, nn, lstm = self._torch.nn.init, self._torch.nn, self.lstm
        *hidden, head = (layer for layer in self.dense if isinstance(layer, nn.Linear))
        for layer in (self.embedding, *hidden, head):
            init.kaiming_normal_(layer.weight, nonlinearity="relu" if layer in hidden else "linear")
            init.zeros_(layer.bias)
        init.kaiming_normal_(lstm.weight_ih_l0, nonlinearity="linear")
        init.orthogonal_(lstm.weight_hh_l0)
        # PyTorch has two biases for each gate. Those of the forget gates, the second quarter, are 1.
        init.zeros_(lstm.bias_hh_l0)
        init.zeros_(lstm.bias_ih_l0)
        init.ones_(lstm.bias_ih_l0.detach()[lstm.hidden_size : 2 * lstm.hidden_size])

    def parameters(self) -> list[Torch]:
        """Return all weights and biases."""
        return [weight for part in (self.embedding, self.lstm, self.dense) for weight in part.parameters()]

    def last_hidden(self, inputs: Torch) -> Torch:
        """Return the LSTM's last hidden states, [B, H], of windows [B, T, O]."""
        _, (last, _) = self.lstm(self.embedding(inputs))
        return last[0]

    def logits(self, inputs: Torch) -> Torch:
        """Return the outputs before the softmax, [B, C], of windows [B, T, O]."""
        return self.dense(self.last_hidden(inputs))


class FoldedNetwork(Network):
    """The same function of the same weights, with the embedding folded into the gates by hand."""

    def last_hidden(self, inputs: Torch) -> Torch:
        """Return the LSTM's last hidden states, [B, H], of windows [B, T, O]."""
        embedding, lstm = self.embedding, self.lstm
        weight = lstm.weight_ih_l0 @ embedding.weight
        bias = lstm.weight_ih_l0 @ embedding.bias + lstm.bias_ih_l0
        weights = [weight, lstm.weight_hh_l0, bias, lstm.bias_hh_l0]
        zeros = inputs.new_zeros(1, len(inputs), lstm.hidden_size)
        _, last, _ = self._torch.lstm(
            inputs,
            (zeros, zeros),
            weights,
            has_biases=True,
            num_layers=1,
            dropout=0.0,
            train=True,
            bidirectional=False,
            batch_first=True,
        )
        return last[0]


class TorchDiagnoser:
    """A plain training loop with the sizes of the task."""

    network: ClassVar[type[Network]] = Network

    def __init__(self, task: Task) -> None:
        self._task = task
        self._torch: Torch = importlib.import_module("torch")
        self._torch.set_num_threads(task.threads)
        self._torch.manual_seed(task.seed)
        self._rng = np.random.default_rng(task.seed)
        self._windows = Windows(task)
        self.note = f"torch {importlib.metadata.version('torch')} {self._use_fastest()}"

    def _use_fastest(self) -> str:
        """Apply the faster of oneDNN and PyTorch's own loop for the LSTM; return the choice as text."""
        trained = self._begin()
        best, seconds = fastest([True, False], self._use_onednn, lambda: self._train(*trained, _TIMED_STEPS))
        found = f"{seconds[True]:.2f} with, {seconds[False]:.2f} without"
        name = "with oneDNN" if best else "without oneDNN"
        return f"{name}, the faster setting (s for {_TIMED_STEPS} minibatches: {found})"

    def _use_onednn(self, use: bool) -> None:
        self._torch.backends.mkldnn.enabled = use

    def answer(self, number: float) -> dict[str, Any]:
        """Train a new network for one epoch and `number` more; return the fields of a `Sample`."""
        trained = self._begin()
        loss = self._train(*trained)
        start = time.perf_counter()
        for _ in range(int(number)):
            loss = self._train(*trained)
        seconds = time.perf_counter() - start
        return {"samples": int(number) * self._task.samples, "seconds": seconds, "loss": loss}

    def _begin(self) -> tuple[Network, Torch]:
        """Return a new network and its optimiser."""
        network = self.network(self._task)
        # One kernel over all weights; PyTorch's default is a dozen of them for each weight.
        return network, self._torch.optim.Adam(network.parameters(), lr=self._task.learning_rate, fused=True)

    def _train(self, network: Network, adam: Torch, most: int | None = None) -> float:
        """Train on every sample once, or on `most` minibatches.

        Returns the mean loss of the samples, each before the optimiser step of its minibatch.
        """
        order, total, done = self._rng.permutation(self._task.samples), 0.0, 0
        for samples in islice(np.array_split(order, self._task.steps), most):
            adam.zero_grad()
            loss = self.loss(network, samples)
            loss.backward()
            adam.step()
            total += len(samples) * loss.item()
            done += len(samples)
        return total / done

    def loss(self, network: Network, samples: NDArray[np.int64]) -> Torch:
        """Return the mean cross-entropy of samples [B]."""
        torch, windows = self._torch, self._windows
        inputs, classes = torch.from_numpy(windows.read(samples)), torch.from_numpy(windows.classes(samples))
        return torch.nn.functional.cross_entropy(network.logits(inputs), classes)

    def close(self) -> None:
        """Free processes and memory."""


class FoldedTorchDiagnoser(TorchDiagnoser):
    """The same loop with `FoldedNetwork`."""

    network = FoldedNetwork
