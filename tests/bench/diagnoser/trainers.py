"""The trainers of ``python -m tests.bench.diagnoser``, as seen by the measuring process."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

from dappo_batch._core import SimulationError

from .. import rounds
from ..commands import TrainingFailed, command_line, read_metrics
from ..entry import WorkerEntry
from .task import Task

__all__ = ["Ours", "Sample", "Torch", "TorchFolded", "Trainer", "sample_of"]

# Validation uses only the one rollout that the task has for it.
_SHARE_OF_ONE_ROLLOUT = 1e-9


@dataclass(frozen=True)
class Sample:
    """Some epochs of one trainer.

    Attributes
    ----------
    samples : int
        Training windows of all epochs.
    seconds : float
        Elapsed time.
    loss : float
        Mean cross-entropy of the last epoch, with dropout.
    """

    samples: int
    seconds: float
    loss: float

    @property
    def rate(self) -> float:
        """Training windows per second."""
        return self.samples / self.seconds


class Trainer(rounds.Trainer[Sample]):
    """A training of new weights: one epoch that is not counted, and those that are measured."""

    def __init__(self, task: Task) -> None:
        self.require()
        self._task = task


class Ours(Trainer):
    """``dappo-batch diagnose train``, one process for each sample."""

    key = "ours"
    about = "dappo-batch diagnose train"

    def train(self, amount: int) -> Sample:
        """Train new weights for one epoch, which is not counted, and `amount` more."""
        task = self._task
        try:
            with tempfile.TemporaryDirectory(prefix="dappo-batch-bench-") as folder:
                out = Path(folder) / "diagnoser"
                arguments = ["diagnose", "train", task.data, "--out", str(out), "--json"]
                arguments += ["--threads", str(task.threads), "--set", *self.settings(amount + 1)]
                command_line(arguments, task.threads)
                return sample_of(read_metrics(out))
        except TrainingFailed as error:
            raise SimulationError(f"{self.key}: {error}") from error

    def settings(self, epochs: int) -> list[str]:
        """Return the values of ``--set`` for `epochs` epochs without early stopping."""
        task = self._task
        return [
            "method=B",
            "head=classes",
            "schedule=constant",
            f"seed={task.seed}",
            f"timesteps={task.timesteps}",
            f"validation_fraction={_SHARE_OF_ONE_ROLLOUT}",
            f"embedding={task.embedding}",
            f"lstm={task.lstm}",
            f"hidden={list(task.hidden)}",
            f"dropout={task.dropout}",
            f"learning_rate={task.learning_rate}",
            f"minibatch_size={task.minibatch}",
            f"epochs={epochs}",
            f"patience={epochs}",
        ]


def sample_of(metrics: tuple[dict[str, Any], ...]) -> Sample:
    """Summarise the epochs of a training without the first, which allocates memory."""
    first, *epochs = metrics
    if not epochs:
        raise TrainingFailed("the training has only one epoch, which is the warm-up")
    try:
        return Sample(
            samples=int(epochs[-1]["samples"]) - int(first["samples"]),
            seconds=sum(float(epoch["seconds"]) for epoch in epochs),
            loss=float(epochs[-1]["train_loss"]),
        )
    except KeyError as error:
        raise TrainingFailed(f"metrics.jsonl lacks {error}") from error


class Torch(WorkerEntry, Trainer):
    """The same network in PyTorch, in a separate process for all rounds."""

    key = "torch"
    about = "PyTorch's layers, as the network is written"
    packages: ClassVar[dict[str, str]] = {"torch": "torch"}
    program = "tests.bench.diagnoser.torch_network:TorchDiagnoser"

    def __init__(self, task: Task) -> None:
        super().__init__(task)
        self.start(task)

    def train(self, amount: int) -> Sample:
        """Train new weights for one epoch, which is not counted, and `amount` more."""
        return Sample(**self.ask(amount))


class TorchFolded(Torch):
    """The same with the embedding folded into the LSTM's gates, as ours does."""

    key = "torch folded"
    about = (
        "PyTorch, its embedding folded into the LSTM's gates by hand: the same function in fewer operations"
    )
    program = "tests.bench.diagnoser.torch_network:FoldedTorchDiagnoser"
