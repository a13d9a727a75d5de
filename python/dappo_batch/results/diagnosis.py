"""Results of training and evaluating a diagnoser."""

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
        Number of the epoch, from 1.
    train_loss, validation_loss : float
        Mean losses: of the training samples during the epoch, with dropout, and of the validation samples
        after it.
    validation_accuracy : float
        Share of the validation samples that are classified correctly.
    learning_rate : float
        Learning rate of the last optimiser step.
    samples : int
        Training samples so far.
    seconds, samples_per_second : float
        Time of the optimiser steps, s, and their rate.
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
    """Summary of a diagnoser on a dataset.

    Attributes
    ----------
    rollouts, windows : int
        Number of rollouts and of diagnosis windows.
    accuracy, standard_error : float
        Share of the windows that are classified correctly, and its standard error over rollouts.
    held_out_accuracy : float or None
        Accuracy on classes that are not in the training data, if there are any.
    log_loss : float
        Mean of -ln p(true class).
    calibration_error : float
        Expected calibration error: mean absolute difference of confidence and accuracy over bins, weighted by
        their windows.
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
    """A misclassification of `damage_class` as `diagnosed`.

    ``share`` is its share of the windows of the class; ``true_score`` and ``mistaken_score`` are those of the
    policy with the code of the true and of the diagnosed class, see `Cost`.
    """

    damage_class: str
    diagnosed: str
    share: float
    true_score: float
    mistaken_score: float


@dataclass(frozen=True)
class Cost(Result):
    """Cost of misclassifications for a policy.

    Attributes
    ----------
    compared_by : str
        What scores are: ``forward_reward``, m/s summed over steps, or ``tracking``, 0 to 1, for a task with
        commands.
    true_score, diagnosed_score : float
        Mean scores of the policy over all classes, with the code of the true and of the diagnosed class.
    gait_equivalent_accuracy : float
        The second as a share of the first.
    mistakes : tuple of Mistake
        In descending order of their cost.
    """

    compared_by: str
    true_score: float
    diagnosed_score: float
    gait_equivalent_accuracy: float
    mistakes: tuple[Mistake, ...]


@dataclass(frozen=True)
class DiagnoserReport(Result):
    """Evaluation of a diagnoser on a dataset.

    Attributes
    ----------
    model, data : str
        Folders of the diagnoser and of the dataset.
    summary : DiagnosisSummary
        Summary over all windows.
    cost : Cost or None
        Cost of misclassifications, if a policy was given.
    classes : tuple of str
        Names of the damage classes.
    class_accuracy : tuple of float
        Share of the windows of each class that are classified correctly.
    """

    model: str
    data: str
    summary: DiagnosisSummary
    cost: Cost | None
    classes: tuple[str, ...]
    class_accuracy: tuple[float | None, ...]
