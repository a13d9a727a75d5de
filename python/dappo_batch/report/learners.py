"""Learners: runs that differ only in their seed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dappo_batch.report.score import Score, score_of
from dappo_batch.report.specialists import HEALTHY, damage_of
from dappo_batch.report.words import grouped_digits
from dappo_batch.runs import Run
from dappo_batch.runs.tables import Table

__all__ = ["AWARE", "UNAWARE", "Curve", "Learner", "Scores", "learners", "matched"]

AWARE, UNAWARE, EXPERT, SPECIALIST = "DA-PPO", "PPO-Unaware", "expert", "specialist"

_POINTS = 50
"""Points of a curve."""
_LONGEST = 36
"""Maximum length of a name that contains the settings."""

# Settings that do not affect training, except by rounding.
_IRRELEVANT = ("seed", "env.threads", "env.njmax", "env.nconmax", "checkpoint.", "evaluation.")
# Values of keys that older versions lack.
_BEFORE = {
    "env.device": "cpu",
    "env.precision": "f64",
    "env.backend": "mujoco",
    "ppo.code_scale": 1.0,
    "ppo.symmetry": False,
}


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

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether all seeds have a value, [K]."""
        known: NDArray[np.bool_] = np.all(np.isfinite(self.values), axis=0)
        return known


@dataclass(frozen=True)
class Scores:
    """What S seeds reach in C damage classes, with standard errors.

    Attributes
    ----------
    names, groups : tuple of str
        Of the damage classes, [C].
    values : float64[S, C]
        Means over episodes of the learner's `Score`, in its unit.
    errors : float64[S, C]
        Their standard errors over episodes; NaN where they are unknown.
    lengths : float64[S, C]
        Mean lengths of the episodes, env steps; NaN where they are unknown.
    """

    names: tuple[str, ...]
    groups: tuple[str, ...]
    values: NDArray[np.float64]
    errors: NDArray[np.float64]
    lengths: NDArray[np.float64]

    @property
    def speed(self) -> float:
        """Mean of forward rewards an env step, m/s; NaN if the lengths of the episodes are unknown."""
        return float(self.values.mean() / self.lengths.mean())

    def of_groups(self) -> Scores:
        """Return the means over the classes of every group, and over ``all`` classes, of the same weight."""
        groups = np.array(self.groups)
        chosen = {name: groups == name for name in self.groups} | {"all": np.ones(len(groups), bool)}

        def means(values: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.stack([values[:, members].mean(axis=1) for members in chosen.values()], axis=1)

        counts = np.array([members.sum() for members in chosen.values()])
        names = tuple(chosen)
        # The errors of independent means add up in squares.
        errors = np.sqrt(means(self.errors**2) / counts)
        return Scores(names, names, means(self.values), errors, means(self.lengths))

    def over_seeds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return the means over seeds, and their standard errors over episodes, [C] each."""
        return self.values.mean(axis=0), np.sqrt((self.errors**2).mean(axis=0) / len(self.errors))

    def only(self, chosen: NDArray[np.intp]) -> Scores:
        """Return some of the classes."""
        names, groups = (tuple(texts[index] for index in chosen) for texts in (self.names, self.groups))
        return Scores(names, groups, *(of[:, chosen] for of in (self.values, self.errors, self.lengths)))


@dataclass(frozen=True)
class Learner:
    """Seeds of one configuration.

    Attributes
    ----------
    kind : str
        `AWARE`, `UNAWARE`, `EXPERT` or `SPECIALIST`.
    name : str
        The kind, and what distinguishes it from others of its kind in the same report: the settings, or a
        letter where they are too long.
    settings : str
        The settings that distinguish it; empty if it is the only one of its kind.
    robot, reward : str
        Names. Where a robot has learners of two scores, its name contains the score.
    score : Score
        What it is compared by.
    runs : tuple of Run
        In the order of their seeds.
    place : int
        Index among the learners of the robot; its mark is the same in every figure.
    relevant : mapping
        All settings that can make two learners differ, as text.
    """

    kind: str
    name: str
    settings: str
    robot: str
    reward: str
    score: Score
    runs: tuple[Run, ...]
    place: int
    relevant: Mapping[str, str]

    def label(self) -> str:
        """Return the name with the number of seeds."""
        return f"{self.name}, {len(self.runs)} seed{'s' if len(self.runs) > 1 else ''}"

    @property
    def env_steps(self) -> tuple[int, ...]:
        """Env steps that each run has done so far."""
        return tuple(int(run.metrics["env_steps"][-1]) for run in self.runs)

    @property
    def seconds(self) -> tuple[float, ...]:
        """Time of rollouts and updates of each run so far, s."""
        parts = ("rollout_seconds", "update_seconds")
        return tuple(sum(float(np.nansum(run.metrics[part])) for part in parts) for run in self.runs)

    def curve(self, column: str, *, weighted: bool) -> Curve | None:
        """Average a column of the metrics over spans of env steps, up to the last one of all seeds.

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

    def scores(self, encoding: str = "true") -> Scores:
        """Return the evaluations of all evaluated seeds with an encoding."""
        tables = [run.per_class[encoding] for run in self.evaluated(encoding)]
        names, groups = (tuple(map(str, tables[0][column])) for column in ("name", "group"))
        values = (
            np.stack([_numbers(table, column, len(names)) for table in tables])
            for column in (self.score.column, self.score.error, "episode_length")
        )
        return Scores(names, groups, *values)


def _numbers(table: Table, column: str, count: int) -> NDArray[np.float64]:
    """Return a column; NaN where an older version did not write it."""
    values = table.get(column)
    if values is None or values.dtype.kind not in "if":
        return np.full(count, np.nan)
    return values.astype(np.float64)


def learners(runs: Sequence[Run]) -> list[Learner]:
    """Group runs; in the order of robots, rewards, kinds and settings.

    A setting is part of a name only where it differs between learners of the same robot and kind. Learners of
    a robot that are compared by different scores count as those of different robots.
    """
    scores = {run.path: score_of(run) for run in runs}
    robots = _robots(runs, scores)
    grouped: dict[tuple[Any, ...], list[Run]] = {}
    settings: dict[tuple[Any, ...], dict[str, str]] = {}
    for run in runs:
        relevant = _relevant(run)
        key = (robots[run.path], _reward(run), _kind(run), tuple(sorted(relevant.items())))
        grouped.setdefault(key, []).append(run)
        settings[key] = relevant
    found: list[Learner] = []
    for key in sorted(grouped):
        robot, reward, kind, _ = key
        rivals = [other for other in sorted(grouped) if other[0] == robot and other[2] == kind]
        described = [
            ", ".join(_distinctions(settings[one], [settings[each] for each in rivals])) for one in rivals
        ]
        own = described[rivals.index(key)]
        name = f"{kind}, {own}" if own else kind
        if max(map(len, described)) + len(kind) > _LONGEST:
            name = f"{kind} {_letters(rivals.index(key))}"
        seeds = tuple(sorted(grouped[key], key=lambda run: (run.seed, str(run.path))))
        place = sum(learner.robot == robot for learner in found)
        score = scores[seeds[0].path]
        found.append(Learner(kind, name, own, robot, reward, score, seeds, place, settings[key]))
    return found


def _letters(place: int) -> str:
    """Return A to Z, then AA to ZZ."""
    return (chr(64 + place // 26) if place >= 26 else "") + chr(65 + place % 26)


def matched(found: Sequence[Learner]) -> list[tuple[Learner, Learner]]:
    """Return pairs of DA-PPO and PPO-Unaware that differ in nothing else, or all pairs if there is none."""

    def common(learner: Learner) -> dict[str, str]:
        own = ("env.observe_damage", "ppo.code_scale")
        return {key: value for key, value in learner.relevant.items() if key not in own}

    pairs = [
        (one, other)
        for one in found
        for other in found
        if (one.kind, other.kind) == (AWARE, UNAWARE) and one.reward == other.reward
    ]
    return [(one, other) for one, other in pairs if common(one) == common(other)] or pairs


def _robots(runs: Sequence[Run], scores: Mapping[Path, Score]) -> dict[Path, str]:
    """Name the robot of each run; a path names its own file."""
    names = {run.path: Path(run.robot).stem for run in runs}
    used: dict[str, set[Score]] = {}
    for path, name in names.items():
        used.setdefault(name, set()).add(scores[path])
    return {
        path: f"{name} ({scores[path].name})" if len(used[name]) > 1 else name for path, name in names.items()
    }


def _reward(run: Run) -> str:
    return str(run.meta.reward or run.config["env"].get("reward") or "of the robot")


def _kind(run: Run) -> str:
    damage = damage_of(run)
    if damage is not None:
        return EXPERT if damage == HEALTHY else SPECIALIST
    return AWARE if run.observes_damage else UNAWARE


def _relevant(run: Run) -> dict[str, str]:
    """Return the settings that can make two learners differ, as text."""
    flat = _BEFORE | dict(_flatten(run.config)) | {"reward": _reward(run), "robot": run.robot}
    flat.pop("env.reward", None)
    if not run.observes_damage:
        # The scale of a code that is not observed.
        flat.pop("ppo.code_scale", None)
    return {key: _text(value) for key, value in flat.items() if not key.startswith(_IRRELEVANT)}


def _flatten(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def _distinctions(own: Mapping[str, str], rivals: Sequence[Mapping[str, str]]) -> list[str]:
    """Return the distinguishing settings as text; a curriculum is abbreviated."""
    keys = sorted({key for rival in rivals for key in (*rival, *own) if rival.get(key) != own.get(key)})
    texts = []
    for key in keys:
        value = own.get(key, "default")
        if key in ("env.history", "ppo.lstm") and key not in own:
            continue  # one step, or what the task has; no memory
        if key == "curriculum":
            texts.append(f"curriculum {_stages(value)}")
        elif key == "total_steps":
            texts.append(f"{grouped_digits(int(value))} env steps")
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
