"""Runs that differ in nothing but their seed are one learner."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dappo_batch.runs import Run

__all__ = ["AWARE", "UNAWARE", "Curve", "Learner", "learners"]

AWARE, UNAWARE, EXPERT = "DA-PPO", "PPO-Unaware", "expert"

_POINTS = 50
"""Points of a curve."""

# What does not change what is learned, or by rounding alone.
_IRRELEVANT = ("seed", "env.threads", "env.njmax", "env.nconmax", "checkpoint.", "evaluation.")
# What older versions did before the key existed.
_BEFORE = {"env.device": "cpu", "env.precision": "f64", "env.backend": "mujoco", "ppo.code_scale": 1.0}


@dataclass(frozen=True)
class Curve:
    """A quantity over training, averaged over equal spans of env steps.

    Attributes
    ----------
    env_steps : float64[K]
        Ends of the spans.
    values : float64[S, K]
        One row a seed; NaN where no episode ended.
    """

    env_steps: NDArray[np.float64]
    values: NDArray[np.float64]


@dataclass(frozen=True)
class Learner:
    """Seeds of one configuration.

    Attributes
    ----------
    kind : str
        `AWARE`, `UNAWARE` or `EXPERT`.
    name : str
        The kind, and what tells it from others of its kind in the same report.
    robot, reward : str
        Names.
    runs : tuple of Run
        In the order of their seeds.
    place : int
        Place among the learners of the robot: every figure gives it the same colour.
    """

    kind: str
    name: str
    robot: str
    reward: str
    runs: tuple[Run, ...]
    place: int

    def label(self) -> str:
        """Return the name with the number of seeds."""
        return f"{self.name}, {len(self.runs)} seed{'s' if len(self.runs) > 1 else ''}"

    def curve(self, column: str, *, weighted: bool) -> Curve | None:
        """Average a column of the metrics over spans of env steps, as far as all seeds have come.

        Parameters
        ----------
        column : str
            Name in ``metrics.jsonl``.
        weighted : bool
            Whether iterations count as often as episodes ended in them, as means over episodes must.

        Returns
        -------
        Curve or None
            None if a seed lacks the column.
        """
        if any(column not in run.metrics for run in self.runs):
            return None
        reached = min(float(run.metrics["env_steps"][-1]) for run in self.runs)
        iterations = min(len(run.metrics["env_steps"]) for run in self.runs)
        ends = reached * np.arange(1, min(_POINTS, iterations) + 1) / min(_POINTS, iterations)
        return Curve(ends, np.array([_spans(run, column, ends, weighted=weighted) for run in self.runs]))

    def evaluated(self, encoding: str = "true") -> tuple[Run, ...]:
        """Return the runs that were evaluated with an encoding."""
        return tuple(run for run in self.runs if encoding in run.per_class)

    def only(self, encodings: Sequence[str]) -> Learner:
        """Return the same learner with the runs that were evaluated with every one of some encodings."""
        runs = [run for run in self.runs if all(name in run.per_class for name in encodings)]
        return replace(self, runs=tuple(runs))

    def forward_rewards(self, encoding: str = "true") -> NDArray[np.float64]:
        """Return the forward reward of every evaluated seed and damage class, [S, C]."""
        return np.array([run.per_class[encoding]["forward_reward"] for run in self.evaluated(encoding)])


def learners(runs: Sequence[Run]) -> list[Learner]:
    """Group runs; in the order of robots, rewards, kinds and settings.

    A setting is part of a name only where it tells two learners of the same robot and kind apart.
    """
    grouped: dict[tuple[Any, ...], list[Run]] = {}
    settings: dict[tuple[Any, ...], dict[str, str]] = {}
    for run in runs:
        relevant = _relevant(run)
        key = (_robot(run), _reward(run), _kind(run), tuple(sorted(relevant.items())))
        grouped.setdefault(key, []).append(run)
        settings[key] = relevant
    found: list[Learner] = []
    for key in sorted(grouped):
        robot, reward, kind, _ = key
        rivals = [settings[other] for other in grouped if other[0] == robot and other[2] == kind]
        details = "".join(f", {text}" for text in _distinctions(settings[key], rivals))
        seeds = tuple(sorted(grouped[key], key=lambda run: (run.seed, str(run.path))))
        place = sum(learner.robot == robot for learner in found)
        found.append(Learner(kind, kind + details, robot, reward, seeds, place))
    return found


def _robot(run: Run) -> str:
    """Name a robot; a path names its own file."""
    return Path(run.robot).stem


def _reward(run: Run) -> str:
    return str(run.meta.reward or run.config["env"].get("reward") or "of the robot")


def _kind(run: Run) -> str:
    mixes = {str(stage.get("mix")) for stage in run.config.get("curriculum", ())}
    if mixes == {"healthy"}:
        return EXPERT
    return AWARE if run.observes_damage else UNAWARE


def _relevant(run: Run) -> dict[str, str]:
    """Return the settings that can make two learners differ, as text."""
    flat = _BEFORE | dict(_flatten(run.config)) | {"reward": _reward(run), "robot": run.robot}
    flat.pop("env.reward", None)
    if not run.observes_damage:
        # The scale of a code that nobody observes.
        flat.pop("ppo.code_scale", None)
    return {key: _text(value) for key, value in flat.items() if not key.startswith(_IRRELEVANT)}


def _flatten(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def _distinctions(own: Mapping[str, str], rivals: Sequence[Mapping[str, str]]) -> list[str]:
    """Return what tells settings from others; a curriculum is too long to be quoted."""
    keys = sorted({key for rival in rivals for key in (*rival, *own) if rival.get(key) != own.get(key)})
    texts = []
    for key in keys:
        value = own.get(key, "default")
        if key == "curriculum":
            texts.append(f"curriculum {_stages(value)}")
        else:
            texts.append(f"{key.rpartition('.')[2].replace('_', ' ')} {value}")
    return texts


def _stages(text: str) -> str:
    return f"of {text.count('budget')} stages" if "budget" in text else text


def _text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _spans(run: Run, column: str, ends: NDArray[np.float64], *, weighted: bool) -> NDArray[np.float64]:
    """Average a column within spans of env steps, [K]."""
    values = run.metrics[column].astype(np.float64)
    weights = run.metrics["episodes"].astype(np.float64) if weighted else np.ones(len(values))
    weights = np.where(np.isfinite(values), weights, 0.0)
    # An iteration belongs to the span in which it ended.
    span = np.searchsorted(ends, run.metrics["env_steps"].astype(np.float64) - 0.5)
    inside = span < len(ends)
    sums = np.bincount(span[inside], (weights * np.nan_to_num(values))[inside], len(ends))
    counts = np.bincount(span[inside], weights[inside], len(ends))
    means = np.full(len(ends), np.nan)
    np.divide(sums, counts, out=means, where=counts > 0)
    return means
