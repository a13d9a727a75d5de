"""The first section: learners, training budgets, and main results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from dappo_batch.report.learners import Learner, matched
from dappo_batch.report.page import Cell, Note, Part, Section, Text, Tiles, Values
from dappo_batch.report.score import Score
from dappo_batch.report.theme import mark
from dappo_batch.report.words import grouped_digits, rounded

__all__ = ["budget_differs", "gain", "overview"]


def overview(
    found: Sequence[Learner],
    names: Mapping[Path, str],
    seconds: Mapping[str, float | None],
    notes: Sequence[str],
) -> Section:
    """Return the section.

    Parameters
    ----------
    found : sequence of Learner
        All learners.
    names : mapping
        Short names of the run folders.
    seconds : mapping
        Duration of an env step by robot, s; None where it is unknown.
    notes : sequence of str
        Notes about inputs that are not in the report.
    """
    parts: list[Part] = [Note(note) for note in (*notes, *_budgets(found), *_unfinished(found, names))]
    if tiles := _tiles(found):
        parts.append(Tiles(tiles))
    scores = list(dict.fromkeys(learner.score for learner in found))
    parts.append(
        Text(
            " ".join(score.explanation for score in scores)
            + " Numbers are means over all damage classes, evaluated after training without exploration "
            "noise; ± is the standard error over episodes."
        )
    )
    # Numbers of different scores cannot be compared.
    parts += [_learners([each for each in found if each.score == score], score, seconds) for score in scores]
    parts.append(_runs(found, names))
    return Section("overview", "Overview", parts)


def budget_differs(found: Sequence[Learner]) -> bool:
    """Return whether some of the runs were trained for other numbers of env steps than others."""
    return len({steps for learner in found for steps in learner.env_steps}) > 1


def gain(aware: Learner, unaware: Learner) -> tuple[str, str]:
    """Return the relative gain of the first in its mean score, and the classes in which it is ahead."""
    ours, theirs = (one.scores().values.mean(axis=0) for one in (aware, unaware))
    relative = f"{100 * (ours.mean() / theirs.mean() - 1):+.1f} %" if theirs.mean() > 0 else "n/a"
    return relative, f"{int((ours > theirs).sum())} of {len(ours)}"


def _by_robot(found: Sequence[Learner]) -> dict[str, list[Learner]]:
    grouped: dict[str, list[Learner]] = {}
    for learner in found:
        grouped.setdefault(learner.robot, []).append(learner)
    return grouped


def _budgets(found: Sequence[Learner]) -> list[str]:
    return [
        f"{robot}: the training budgets differ ("
        + "; ".join(f"{learner.name}: {_range(learner.env_steps)}" for learner in of_robot)
        + " env steps). Compare only learners with the same budget."
        for robot, of_robot in _by_robot(found).items()
        if budget_differs(of_robot)
    ]


def _range(steps: Sequence[int]) -> str:
    low, high = grouped_digits(min(steps)), grouped_digits(max(steps))
    return low if low == high else f"{low} to {high}"


def _unfinished(found: Sequence[Learner], names: Mapping[Path, str]) -> list[str]:
    return [
        f"{names[run.path]} is not finished: {grouped_digits(done)} of "
        f"{grouped_digits(int(run.config['total_steps']))} env steps."
        for learner in found
        for run, done in zip(learner.runs, learner.env_steps, strict=True)
        if done < int(run.config["total_steps"])
    ]


def _tiles(found: Sequence[Learner]) -> list[tuple[str, str]]:
    """Return the result of the first pair of DA-PPO and PPO-Unaware, or of the only learner."""
    evaluated = [learner for learner in found if learner.evaluated()]
    if not evaluated:
        return []
    pairs = [
        (one, other)
        for one, other in matched(evaluated)
        if one.robot == other.robot and one.scores().names == other.scores().names
    ]
    first = pairs[0][0] if pairs else evaluated[0]
    score, scores = first.score, first.scores()
    tiles = [(rounded(scores.values.mean(), score.digits), f"{score.name} of {first.name}, {first.robot}")]
    if score.is_distance and np.isfinite(scores.speed):
        tiles.append((f"{rounded(scores.speed, 2)} m/s", f"mean forward speed of {first.name}"))
    if pairs:
        relative, ahead = gain(*pairs[0])
        differs = ", budgets differ" if budget_differs(pairs[0]) else ""
        if relative != "n/a":
            tiles.append(
                (relative, f"{score.name} of {first.name} compared with {pairs[0][1].name}{differs}")
            )
        tiles.append((ahead, f"damage classes in which {first.name} is ahead"))
    return tiles


def _learners(found: Sequence[Learner], score: Score, seconds: Mapping[str, float | None]) -> Values:
    # Settings in the name need no column.
    has_settings = any(learner.settings not in learner.name for learner in found)
    has_seeds = any(len(learner.evaluated()) > 1 for learner in found)
    header = ["learner", "robot", *(["settings"] if has_settings else []), "reward", "seeds", "env steps"]
    header += [score.name, *(["lowest seed", "highest seed"] if has_seeds else [])]
    header += ["m/s", "m per episode"] if score.is_distance else []
    rows = []
    for learner in found:
        row: list[str | Cell] = [Cell(learner.name, mark(learner.place)), learner.robot]
        row += [learner.settings] if has_settings else []
        row += [learner.reward, f"{len(learner.runs)}", _steps(learner.env_steps, found, learner.robot)]
        if learner.evaluated():
            scores = learner.scores()
            seeds, second = scores.values.mean(axis=1), seconds[learner.robot]
            error = scores.of_groups().over_seeds()[1][-1]
            mean, error, low, high = (
                rounded(value, score.digits) for value in (seeds.mean(), error, seeds.min(), seeds.max())
            )
            row += [f"{mean} ± {error}", *([low, high] if has_seeds else [])]
            if score.is_distance:
                distance = None if second is None else seeds.mean() * second
                row += [rounded(scores.speed, 2), rounded(distance)]
        else:
            row += ["n/a"] * (len(header) - len(row))
        rows.append(row)
    return Values(header, rows)


def _steps(steps: Sequence[int], found: Sequence[Learner], robot: str) -> Cell:
    """Return numbers of env steps; flagged if some are less than others of the robot have."""
    most = max(done for learner in found if learner.robot == robot for done in learner.env_steps)
    return Cell(_range(steps), is_flagged=min(steps) < most)


def _runs(found: Sequence[Learner], names: Mapping[Path, str]) -> Values:
    header = ("run", "learner", "seed", "env steps", "robot", "reward", "folder")
    rows = [
        (
            *(names[run.path], Cell(learner.name, mark(learner.place)), f"{run.seed}"),
            *(_steps([done], found, learner.robot), learner.robot, learner.reward, str(run.path)),
        )
        for learner in found
        for run, done in zip(learner.runs, learner.env_steps, strict=True)
    ]
    return Values(header, rows)
