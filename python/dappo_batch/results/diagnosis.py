"""The training of a diagnoser epoch by epoch, and tests of it."""

from __future__ import annotations

from dataclasses import dataclass

from dappo_batch.results.base import Result

__all__ = ["Cost", "DiagnoserReport", "DiagnosisSummary", "EpochMetrics", "Mistake"]


@dataclass(frozen=True)
class EpochMetrics(Result):
    """One epoch of `train_diagnoser`, a line of ``metrics.jsonl``.

    Attributes
    ----------
    epoch : int
        Its number, from 1.
    train_loss, validation_loss : float
        Mean losses: of the training samples before the steps that they took part in, with dropout, and of the
        validation samples after the epoch.
    validation_accuracy : float
        Share of the validation samples whose class was named.
    learning_rate : float
        That of the last step.
    samples : int
        Samples trained on so far.
    seconds, samples_per_second : float
        Time of the training steps, s, and their rate.
    """

    epoch: int
    train_loss: float
    validation_loss: float | None
    validation_accuracy: float | None
    learning_rate: float
    samples: int
    seconds: float
    samples_per_second: float


@dataclass(frozen=True)
class DiagnosisSummary(Result):
    """A diagnoser on a dataset in a few numbers.

    Attributes
    ----------
    rollouts, windows : int
        What was diagnosed.
    accuracy, standard_error : float
        Share of the windows whose class was named, and its standard error over rollouts.
    held_out_accuracy : float or None
        Accuracy on classes that were not trained on, if there are any.
    log_loss : float
        Mean of -ln p(true class).
    calibration_error : float
        Mean distance of confidence and accuracy over the bins, weighted by their windows.
    """

    rollouts: int
    windows: int
    accuracy: float
    standard_error: float | None
    held_out_accuracy: float | None
    log_loss: float
    calibration_error: float


@dataclass(frozen=True)
class Mistake(Result):
    """A class that is called another: its share of the windows, and the policy's reward told either."""

    damage_class: str
    named: str
    share: float
    told_truth: float
    told_mistake: float


@dataclass(frozen=True)
class Cost(Result):
    """What wrong diagnoses cost a policy: its mean forward reward told the truth, and told the diagnoses.

    ``gait_equivalent_accuracy`` is the second as a share of the first; ``mistakes`` begin with the costliest.
    """

    told_truth: float
    told_diagnosis: float
    gait_equivalent_accuracy: float
    mistakes: tuple[Mistake, ...]


@dataclass(frozen=True)
class DiagnoserReport(Result):
    """A diagnoser on a dataset, by their folders.

    Attributes
    ----------
    model, data : str
        The folders.
    summary : DiagnosisSummary
        The essence.
    cost : Cost or None
        What mistakes cost, if a policy was given.
    classes : tuple of str
        Names of the damage classes.
    class_accuracy : tuple of float
        Share of the windows of each class that were named.
    """

    model: str
    data: str
    summary: DiagnosisSummary
    cost: Cost | None
    classes: tuple[str, ...]
    class_accuracy: tuple[float | None, ...]
