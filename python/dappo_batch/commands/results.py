"""What commands found, as frozen dataclasses with the numbers that ``--json`` prints.

A forward reward is the mean over episodes of the sum of forward velocities, m/s. What cannot be known, as the
standard error of a single episode, is None.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import NoneType, UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

__all__ = [
    "AdaptationReport",
    "AdaptationSummary",
    "ClassComparison",
    "ClassOutcome",
    "ClassResult",
    "Comparison",
    "ComparisonSummary",
    "Cost",
    "DecisionTime",
    "DiagnoserReport",
    "DiagnosisSummary",
    "EpochMetrics",
    "Estimate",
    "EvaluationReport",
    "Gain",
    "GroupResult",
    "Mistake",
    "Result",
    "RunEvaluation",
    "RunSummary",
    "Side",
    "Told",
    "Trial",
]

T = TypeVar("T", bound="Result")

_KEYS = {"damage_class": "class"}
"""Keys of JSON that cannot be names in Python."""


@dataclass(frozen=True)
class Result:
    """What all results have in common."""

    def to_dict(self) -> dict[str, Any]:
        """Return everything as JSON can hold it, with the keys that ``--json`` prints."""
        names = (field.name for field in fields(self))
        return {_KEYS.get(name, name): _plain(getattr(self, name)) for name in names}

    @classmethod
    def from_dict(cls: type[T], told: Mapping[str, Any]) -> T:
        """Make a result from what `to_dict` returns."""
        return cls(**{name: _typed(kind, told[_KEYS.get(name, name)]) for name, kind in _kinds(cls).items()})


def _kinds(cls: type[Result]) -> dict[str, Any]:
    """Return the types of the fields by name."""
    hints = get_type_hints(cls)
    return {field.name: hints[field.name] for field in fields(cls)}


def _typed(kind: Any, value: Any) -> Any:  # noqa: ANN401 - whatever a field is
    if value is None:
        return None
    if isinstance(kind, UnionType):
        (kind,) = (one for one in get_args(kind) if one is not NoneType)
    if get_origin(kind) is tuple:
        return tuple(_typed(get_args(kind)[0], item) for item in value)
    if isinstance(kind, type) and issubclass(kind, Result):
        return kind.from_dict(value)
    return value


def _plain(value: Any) -> Any:  # noqa: ANN401
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value.to_dict() if isinstance(value, Result) else value


@dataclass(frozen=True)
class ClassResult(Result):
    """A policy with one damage class: its number, name and group, and means over episodes.

    ``episode_length`` is in env steps; ``falls`` counts episodes that ended in failure, ``diverged`` those
    among them whose physics diverged.
    """

    damage_class: int
    name: str
    group: str
    episodes: int
    forward_reward: float
    standard_error: float | None
    episode_return: float
    episode_length: float
    falls: int
    diverged: int


@dataclass(frozen=True)
class GroupResult(Result):
    """A policy with a group of damage classes, each of the same weight; the group ``all`` holds every class.

    The standard error is that over episodes, and says nothing about the spread between classes.
    """

    group: str
    classes: int
    episodes: int
    forward_reward: float
    standard_error: float | None
    falls: int
    diverged: int


@dataclass(frozen=True)
class RunEvaluation(Result):
    """The evaluation of one run.

    Attributes
    ----------
    run : str
        Its run folder.
    seed, env_steps : int
        Seed of its training, and the env steps that its policy was trained for.
    encoding : str
        What the policy was told: ``true``, ``zero``, ``wrong`` or ``random``.
    backend, precision, device, physics : str
        What simulated.
    classes : tuple of ClassResult
        One entry a damage class, in the order of their numbers.
    groups : tuple of GroupResult
        One entry a group, and one for all classes.
    """

    run: str
    seed: int
    env_steps: int
    encoding: str
    backend: str
    precision: str
    device: str
    physics: str
    classes: tuple[ClassResult, ...]
    groups: tuple[GroupResult, ...]


@dataclass(frozen=True)
class RunSummary(Result):
    """One run of a comparison; the forward reward is the mean over all classes."""

    run: str
    seed: int
    env_steps: int
    forward_reward: float


@dataclass(frozen=True)
class Side(Result):
    """One side of a comparison: runs of one learner that differ in their seeds, and their mean."""

    encoding: str
    forward_reward: float
    seeds: tuple[RunSummary, ...]


@dataclass(frozen=True)
class Estimate(Result):
    """A number with its interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Gain(Result):
    """How much more one learner reaches than another, on average over some damage classes.

    ``absolute`` is the difference of the means, m/s; ``relative`` their ratio minus 1, or None if the other
    mean is not above 0 in every resample.
    """

    classes: int
    absolute: Estimate
    relative: Estimate | None


@dataclass(frozen=True)
class ComparisonSummary(Result):
    """What a comparison says in a few numbers.

    Attributes
    ----------
    runs, others : Side
        The side whose gain is asked for, and the one that it is compared with.
    episodes, evaluation_seed : int
        Episodes of each class and run, and the seed of their start states and of the resamples.
    backend, precision, device, physics : str
        What simulated.
    classes_won : int
        Classes in which the first side is ahead on average over its seeds.
    share_won : float
        Their share, 0 to 1.
    gain : Gain
        Over all classes.
    adjacent_pairs, opposite_pairs : Gain or None
        Over the classes with two damages on such limbs, if the robot has any.
    resamples : int
        Resamples of each interval.
    confidence : float
        Share of the resamples inside an interval.
    intervals_cover : str
        What was drawn anew in each resample.
    """

    runs: Side
    others: Side
    episodes: int
    evaluation_seed: int
    backend: str
    precision: str
    device: str
    physics: str
    classes_won: int
    share_won: float
    gain: Gain
    adjacent_pairs: Gain | None
    opposite_pairs: Gain | None
    resamples: int
    confidence: float
    intervals_cover: str


@dataclass(frozen=True)
class ClassComparison(Result):
    """One damage class of a comparison; ``difference`` is the first side's reward minus the other's."""

    damage_class: int
    name: str
    group: str
    forward_reward: float
    other_forward_reward: float
    difference: float
    better: bool


@dataclass(frozen=True)
class Comparison(Result):
    """A comparison of two learners, in a few numbers and class by class."""

    summary: ComparisonSummary
    classes: tuple[ClassComparison, ...]


@dataclass(frozen=True)
class EvaluationReport(Result):
    """What `evaluate` found: its ``runs``, the ``others`` of ``compare``, and their comparison, if any."""

    runs: tuple[RunEvaluation, ...]
    others: tuple[RunEvaluation, ...]
    comparison: Comparison | None


@dataclass(frozen=True)
class Trial(Result):
    """What was tried: damage classes, episodes of each, the step at which damage strikes, and the seed."""

    classes: tuple[int, ...]
    episodes: int
    onset: int
    seed: int


@dataclass(frozen=True)
class Told(Result):
    """A damage class by its name, and the number of episodes at whose end the policy was told it."""

    name: str
    episodes: int


@dataclass(frozen=True)
class ClassOutcome(Result):
    """A controller with one damage class.

    Attributes
    ----------
    damage_class, name
        The class.
    episodes, ended_before : int
        Episodes in which the damage struck, and those that ended before; the latter count for nothing else.
    false_alarms : int
        Episodes with a suspicion before the damage, or at all if the robot stays healthy.
    detected : int
        Episodes in which damage was suspected after it struck.
    median_delay, median_recovery : float or None
        Env steps from the damage to the suspicion, and to a recovery, where there was one.
    right_at_first, right_at_last : int
        Episodes whose first diagnosis was right, and those in which the policy was told the right class at
        the end.
    told : tuple of Told
        What the policy was told in the end, the most frequent first.
    examinations : float
        Examinations an episode.
    recovered : int
        Episodes in which the robot walked at four fifths of the oracle's speed at some time after the
        diagnosis.
    falls : int
        Episodes that ended in failure.
    velocity_before : float
        Forward velocity before the damage, m/s.
    adapted, oracle, unadapted, unaware : float or None
        Forward reward of the controller; of a policy that is told the truth at once, unless it does not know
        the damage; of the policy that takes the robot for healthy; and of PPO-Unaware, if there is one.
    """

    damage_class: int
    name: str
    episodes: int
    ended_before: int
    false_alarms: int
    detected: int
    median_delay: float | None
    right_at_first: int
    right_at_last: int
    told: tuple[Told, ...]
    examinations: float | None
    recovered: int
    median_recovery: float | None
    falls: int
    velocity_before: float | None
    adapted: float | None
    oracle: float | None
    unadapted: float | None
    unaware: float | None


@dataclass(frozen=True)
class DecisionTime(Result):
    """How long a controller took for an env step of all its robots, ms."""

    robots: int
    median: float | None
    p99: float | None
    longest: float | None


@dataclass(frozen=True)
class AdaptationSummary(Result):
    """What `adapt` says in a few numbers; shares lie between 0 and 1, and are None without such episodes.

    Attributes
    ----------
    classes : tuple of ClassOutcome
        One entry a damage class, in the order of the trial.
    healthy_without_alarm : float or None
        Share of the healthy episodes without any suspicion.
    severe_episodes : int
        Episodes of damages that cost more than half of the speed when nothing is done about them.
    severe_detected, severe_median_delay : float or None
        Share of them in which damage was suspected, and the median number of env steps that this took.
    right_at_first, right_at_last : float or None
        Shares of the damaged episodes whose first diagnosis was right, and whose policy was told the right
        class in the end.
    recovered_share, unadapted_share, unaware_share : float or None
        Forward reward over the damages that the policy knows, as a share of the oracle's: of the controller,
        of the policy that takes every robot for healthy, and of PPO-Unaware.
    decision_ms : DecisionTime
        How long the controller took.
    """

    classes: tuple[ClassOutcome, ...]
    healthy_without_alarm: float | None
    severe_episodes: int
    severe_detected: float | None
    severe_median_delay: float | None
    right_at_first: float | None
    right_at_last: float | None
    recovered_share: float | None
    unadapted_share: float | None
    unaware_share: float | None
    decision_ms: DecisionTime


@dataclass(frozen=True)
class AdaptationReport(Result):
    """What `adapt` found: the trial, its summary and, for a single damage, the events of each episode.

    An event is a dict as those of `Controller.events`.
    """

    trial: Trial
    summary: AdaptationSummary
    events: tuple[tuple[dict[str, Any], ...], ...]


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
