"""Evaluations of policies on damage classes, and comparisons of learners."""

from __future__ import annotations

from dataclasses import dataclass

from dappo_batch.results.base import Result

__all__ = [
    "ClassComparison",
    "ClassResult",
    "Comparison",
    "ComparisonSummary",
    "Estimate",
    "EvaluationReport",
    "Gain",
    "GroupResult",
    "RunEvaluation",
    "RunSummary",
    "Side",
]


@dataclass(frozen=True)
class ClassResult(Result):
    """Results of a policy with one damage class, as means over episodes.

    ``forward_reward`` is the sum of the forward velocity (m/s) over the env steps of an episode,
    ``forward_velocity`` its mean over all steps in m/s, ``distance`` the distance of an episode in m.
    ``tracking`` is how well commanded velocities are tracked, the mean of the term ``track_lin_vel`` over the
    steps of an episode, 0 after a fall; None for a task without commands. ``standard_error`` and
    ``tracking_standard_error`` are those of the forward reward and of the tracking, over episodes.
    ``episode_length`` is in env steps; ``falls`` counts terminated episodes, ``diverged`` those among them
    whose physics diverged.
    """

    damage_class: int
    name: str
    group: str
    episodes: int
    forward_reward: float
    standard_error: float | None
    forward_velocity: float
    distance: float
    episode_return: float
    episode_length: float
    falls: int
    diverged: int
    tracking: float | None = None
    tracking_standard_error: float | None = None


@dataclass(frozen=True)
class GroupResult(Result):
    """Results of a policy with a group of equally weighted damage classes; ``all`` contains every class.

    Standard errors are over episodes and do not include the spread between classes.
    """

    group: str
    classes: int
    episodes: int
    forward_reward: float
    standard_error: float | None
    forward_velocity: float
    distance: float
    falls: int
    diverged: int
    tracking: float | None = None
    tracking_standard_error: float | None = None


@dataclass(frozen=True)
class RunEvaluation(Result):
    """The evaluation of one run.

    Attributes
    ----------
    run : str
        The run folder, or the function that took the place of its policy.
    seed, env_steps : int or None
        Seed of the training, and env steps that the policy was trained for; None for a function.
    encoding : str
        Damage code that the policy received: ``true``, ``zero``, ``wrong`` or ``random``.
    backend, precision, device, physics : str
        Simulation of the episodes.
    classes : tuple of ClassResult
        One entry for each damage class, in the order of their ids.
    groups : tuple of GroupResult
        One entry for each group, and one for all classes.
    """

    run: str
    seed: int | None
    env_steps: int | None
    encoding: str
    backend: str
    precision: str
    device: str
    physics: str
    classes: tuple[ClassResult, ...]
    groups: tuple[GroupResult, ...]


@dataclass(frozen=True)
class RunSummary(Result):
    """One run of a comparison; forward reward, velocity (m/s) and distance (m) are means over all classes."""

    run: str
    seed: int | None
    env_steps: int | None
    forward_reward: float
    forward_velocity: float
    distance: float
    tracking: float | None = None


@dataclass(frozen=True)
class Side(Result):
    """One side of a comparison: runs of one learner that differ in their seeds, and their mean."""

    encoding: str
    forward_reward: float
    forward_velocity: float
    distance: float
    seeds: tuple[RunSummary, ...]
    tracking: float | None = None


@dataclass(frozen=True)
class Estimate(Result):
    """An estimate with its confidence interval."""

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class Gain(Result):
    """Difference between two learners, averaged over damage classes.

    ``absolute`` is the difference of the means of what the learners are compared by; ``relative`` their
    ratio minus 1, or None if the other mean is not above 0 in every resample.
    """

    classes: int
    absolute: Estimate
    relative: Estimate | None


@dataclass(frozen=True)
class ComparisonSummary(Result):
    """Summary of a comparison.

    Attributes
    ----------
    runs, others : Side
        The side whose gain is computed, and the one with which it is compared.
    episodes, evaluation_seed : int
        Episodes of each class and run, and the seed of their start states and of the resamples.
    backend, precision, device, physics : str
        Simulation of the episodes.
    classes_won : int
        Classes in which the first side has the higher mean over its seeds.
    share_won : float
        Share of these classes, 0 to 1.
    gain : Gain
        Over all classes.
    adjacent_pairs, opposite_pairs : Gain or None
        Over the classes with two damages on adjacent or opposite limbs, if the robot has any.
    resamples : int
        Bootstrap resamples of each interval.
    confidence : float
        Confidence level of the intervals, 0 to 1.
    intervals_cover : str
        What each resample draws.
    compared_by : str
        ``forward_reward``, m/s summed over steps, or ``tracking``, 0 to 1, for a task with commands.
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
    compared_by: str


@dataclass(frozen=True)
class ClassComparison(Result):
    """One damage class of a comparison; ``score`` is what the learners are compared by."""

    damage_class: int
    name: str
    group: str
    score: float
    other_score: float
    difference: float
    better: bool


@dataclass(frozen=True)
class Comparison(Result):
    """A comparison of two learners: summary, and class by class."""

    summary: ComparisonSummary
    classes: tuple[ClassComparison, ...]


@dataclass(frozen=True)
class EvaluationReport(Result):
    """Result of `evaluate`: its ``runs``, the ``others`` of ``compare``, and their comparison, if any."""

    runs: tuple[RunEvaluation, ...]
    others: tuple[RunEvaluation, ...]
    comparison: Comparison | None
