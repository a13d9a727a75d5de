"""Events of a controller, and what `adapt` found, as frozen dataclasses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dappo_batch._checks import mapping, shown
from dappo_batch._core import ConfigError
from dappo_batch.results.base import Result, entry

__all__ = ["AdaptationReport", "AdaptationSummary", "ClassOutcome", "DecisionTime", "Event", "Told", "Trial"]


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
        Episodes in which the robot was diagnosed after the damage, neither fell nor stood still, and kept at
        least four fifths of the speed that the oracle keeps.
    falls, stood_still : int
        Episodes that ended in failure, and those that ended at less than a tenth of the speed before the
        damage.
    velocity_before, velocity_kept, oracle_velocity_kept : float or None
        Forward velocity before the damage, over the last 200 env steps, and that of the oracle over the last
        200, m/s. A robot that fell has 0; the oracle has none for damage that it does not know.
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
    stood_still: int
    velocity_before: float | None
    velocity_kept: float | None
    oracle_velocity_kept: float | None
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
    recovered, stood_still, fell : float or None
        Shares of the damaged episodes: those in which the robot recovered, of the damages that the policy
        knows, those at whose end it stood still, and those that ended in failure.
    kept_of_oracle, kept_of_healthy : float or None
        Forward velocity over the last 200 env steps with the damages that the policy knows, as a share of
        the oracle's, and of that before the damage.
    adapted_share, unadapted_share, unaware_share : float or None
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
    recovered: float | None
    stood_still: float | None
    fell: float | None
    kept_of_oracle: float | None
    kept_of_healthy: float | None
    adapted_share: float | None
    unadapted_share: float | None
    unaware_share: float | None
    decision_ms: DecisionTime


@dataclass(frozen=True)
class AdaptationReport(Result):
    """What `adapt` found: the trial, its summary and, for a single damage, the events of each episode.

    An event is a dict with the keys of the JSON; `Event.from_dict` reads it.
    """

    trial: Trial
    summary: AdaptationSummary
    events: tuple[tuple[dict[str, Any], ...], ...]


@dataclass(frozen=True)
class Event:
    """Something that a `Controller` noticed or did. What does not belong to its kind is None.

    Attributes
    ----------
    kind : str
        ``suspected``, ``diagnosed``, ``adapted``, ``withdrawn``, ``readings_lost`` or ``readings_back``.
    step : int
        Control steps since the start of the robot.
    robot : int
        Index of the robot.
    damage_class : int
        The most probable class (``diagnosed``), the one that the policy is told from now on (``adapted``), or
        the one that had been named (``withdrawn``).
    confidence : float
        Its probability (``diagnosed``).
    accepted : bool
        Whether that was enough to believe it (``diagnosed``).
    forward_velocity, expected : float
        Mean forward velocity over the last steps, and that of the class that the policy is told, m/s
        (``suspected``).
    residual : float
        Median residual over the last steps (``suspected``), or of the twin with the damage (``withdrawn``).
    healthy : float
        Median residual of the healthy twin (``withdrawn``).
    faults : int
        Entries of the observation that are not finite (``readings_lost``).
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
    faults: int | None = None

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> Event:
        """Read an event as `adapt` and its JSON give it.

        Raises
        ------
        ConfigError
            If it has no kind or no step, or an entry has the wrong type.
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
            faults=entry(found, "faults", int, what),
        )
