"""Events of a controller, and results of `adapt`, as frozen dataclasses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dappo_batch._checks import mapping, shown
from dappo_batch._core import ConfigError
from dappo_batch.results.base import Result, entry

__all__ = [
    "AdaptationReport",
    "AdaptationSummary",
    "AssumedClass",
    "ClassOutcome",
    "DecisionTime",
    "Event",
    "Trial",
]


@dataclass(frozen=True)
class Trial(Result):
    """Setting of a trial: damage classes, episodes of each class, onset in env steps, and the seed."""

    classes: tuple[int, ...]
    episodes: int
    onset: int
    seed: int


@dataclass(frozen=True)
class AssumedClass(Result):
    """A damage class by its name, and the number of episodes in which it was the assumed class at the end."""

    name: str
    episodes: int


@dataclass(frozen=True)
class ClassOutcome(Result):
    """Results of a controller with one damage class.

    Attributes
    ----------
    damage_class, name
        The class.
    episodes, ended_before_onset : int
        Episodes that reached the onset, and episodes that ended before it, which are not counted anywhere
        else.
    false_alarms : int
        Episodes with an alarm before the onset, or with any alarm if the robot stays healthy. An alarm is a
        suspicion, or a change of the assumed class if the controller has no twin.
    detected : int
        Episodes with an alarm after the onset.
    median_delay, median_recovery : float or None
        Env steps from the onset to the alarm, and to the recovery, over the episodes that had one.
    correct_first, correct_last : int
        Episodes whose first diagnosis was correct, and episodes whose assumed class was correct at the end.
    assumed : tuple of AssumedClass
        The assumed classes at the end of the episodes, the most frequent first.
    diagnosis_windows : float
        Mean number of diagnosis windows of an episode, or of changes of the assumed class without a twin.
    recovered : int
        Episodes in which damage was diagnosed after the onset and the robot neither fell nor stood still and
        kept at least 80 % of the oracle's speed, or tracking, over the last 200 env steps.
    falls, stood_still : int
        Episodes that ended with a fall, and episodes without a fall in which the robot kept less than a tenth
        of the speed before the onset over the last 200 env steps. A robot with commands stood still if it was
        not commanded to and tracked them hardly better than a robot at rest.
    velocity_before, velocity_kept, oracle_velocity_kept : float or None
        Forward velocity before the onset, over the last 200 env steps, and that of the oracle over the last
        200, m/s. It is 0 after a fall, and None for the oracle if the policy was not trained on the damage.
    adapted, oracle, no_adaptation, unaware : float or None
        Forward reward, or tracking summed over env steps for a task with commands, of the controller; of the
        oracle, if the policy was trained on the damage; of the policy without adaptation; and of PPO-Unaware,
        if it was given.
    tracking_before, tracking_kept, oracle_tracking_kept : float or None
        How well commanded velocities were tracked, 0 to 1: before the onset, over the last 200 env steps, and
        by the oracle over the last 200. None for a task without commands.
    """

    damage_class: int
    name: str
    episodes: int
    ended_before_onset: int
    false_alarms: int
    detected: int
    median_delay: float | None
    correct_first: int
    correct_last: int
    assumed: tuple[AssumedClass, ...]
    diagnosis_windows: float | None
    recovered: int
    median_recovery: float | None
    falls: int
    stood_still: int
    velocity_before: float | None
    velocity_kept: float | None
    oracle_velocity_kept: float | None
    adapted: float | None
    oracle: float | None
    no_adaptation: float | None
    unaware: float | None
    tracking_before: float | None = None
    tracking_kept: float | None = None
    oracle_tracking_kept: float | None = None


@dataclass(frozen=True)
class DecisionTime(Result):
    """Time of a controller for one env step of all its robots, ms."""

    robots: int
    median: float | None
    p99: float | None
    longest: float | None


@dataclass(frozen=True)
class AdaptationSummary(Result):
    """Summary of `adapt`. Shares are between 0 and 1, and None without such episodes.

    Attributes
    ----------
    classes : tuple of ClassOutcome
        One entry for each damage class, in the order of the trial.
    healthy_without_alarm : float or None
        Share of the healthy episodes without an alarm.
    severe_episodes : int
        Episodes with damage that reduces the speed, or tracking, by more than half without adaptation.
    severe_detected, severe_median_delay : float or None
        Share of them with an alarm after the onset, and the median number of env steps until then.
    correct_first, correct_last : float or None
        Shares of the damaged episodes whose first diagnosis was correct, and whose assumed class was correct
        at the end.
    recovered, stood_still, fell : float or None
        Shares of the damaged episodes: recovered (over damage that the policy was trained on), stood still,
        and fell.
    kept_of_oracle, kept_of_healthy : float or None
        Forward velocity, or tracking, over the last 200 env steps as a share of the oracle's, and of that
        before the onset, over damage that the policy was trained on.
    adapted_share, no_adaptation_share, unaware_share : float or None
        Forward reward, or tracking, from the onset on as a share of the oracle's, over damage that the policy
        was trained on: of the controller, of the policy without adaptation, and of PPO-Unaware.
    decision_ms : DecisionTime
        Time of the controller for an env step.
    """

    classes: tuple[ClassOutcome, ...]
    healthy_without_alarm: float | None
    severe_episodes: int
    severe_detected: float | None
    severe_median_delay: float | None
    correct_first: float | None
    correct_last: float | None
    recovered: float | None
    stood_still: float | None
    fell: float | None
    kept_of_oracle: float | None
    kept_of_healthy: float | None
    adapted_share: float | None
    no_adaptation_share: float | None
    unaware_share: float | None
    decision_ms: DecisionTime


@dataclass(frozen=True)
class AdaptationReport(Result):
    """Result of `adapt`: the trial, its summary and, for a single damage class, the events of each episode.

    Events are dicts with the keys of the JSON; `Event.from_dict` reads them.
    """

    trial: Trial
    summary: AdaptationSummary
    events: tuple[tuple[dict[str, Any], ...], ...]


@dataclass(frozen=True)
class Event:
    """An event of a `Controller`. Attributes that do not belong to its kind are None.

    Attributes
    ----------
    kind : str
        ``suspected``, ``diagnosed``, ``adapted``, ``withdrawn``, ``observation_invalid`` or
        ``observation_valid``.
    step : int
        Control steps since the reset of the robot.
    robot : int
        Index of the robot.
    damage_class : int
        The diagnosed class (``diagnosed``), the new assumed class (``adapted``), or the class of the
        withdrawn diagnosis (``withdrawn``).
    confidence : float
        Probability of the diagnosed class (``diagnosed``).
    accepted : bool
        Whether the confidence is high enough for an adaptation (``diagnosed``).
    forward_velocity, expected : float
        Mean forward velocity over the last steps, and the expected one with the assumed class, m/s
        (``suspected``).
    residual : float
        Median residual over the last steps (``suspected``), or of the twin with the diagnosed damage
        (``withdrawn``).
    healthy : float
        Median residual of the healthy twin (``withdrawn``).
    entries : int
        Number of entries of the observation that are not finite (``observation_invalid``).
    """

    kind: str
    step: int
    robot: int = 0
    damage_class: int | None = None
    confidence: float | None = None
    accepted: bool | None = None
    forward_velocity: float | None = None
    expected: float | None = None
    residual: float | None = None
    healthy: float | None = None
    entries: int | None = None

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> Event:
        """Read an event from its JSON object.

        Raises
        ------
        ConfigError
            If it has no kind or no step, or an entry has a wrong type.
        """
        what = "an event"
        found = mapping(found, what)
        kind, step = entry(found, "event", str, what), entry(found, "step", int, what)
        if kind is None or step is None:
            raise ConfigError(f"an event has no step or no kind: {shown(found)}")
        return cls(
            kind=kind,
            step=step,
            robot=entry(found, "robot", int, what) or 0,
            damage_class=entry(found, "class", int, what),
            confidence=entry(found, "confidence", float, what),
            accepted=entry(found, "accepted", bool, what),
            forward_velocity=entry(found, "forward_velocity", float, what),
            expected=entry(found, "expected", float, what),
            residual=entry(found, "residual", float, what),
            healthy=entry(found, "healthy", float, what),
            entries=entry(found, "entries", int, what),
        )
