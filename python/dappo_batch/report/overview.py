"""The first section: learners, training budgets, and main results."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from dappo_batch.report.learners import Learner, matched
from dappo_batch.report.page import Cell, Note, Part, Section, Text, Tiles, Values
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
    parts.append(
        Text(
            "Forward reward is the sum of the forward velocity (m/s) over the env steps of an episode: times "
            "the duration of an env step a distance in m, divided by the number of env steps a speed in m/s. "
            "Numbers are means over all damage classes, evaluated after training without exploration noise; "
            "± is the standard error over episodes."
        )
    )
    parts += [_learners(found, seconds), _runs(found, names)]
    return Section("overview", "Overview", parts)


def budget_differs(found: Sequence[Learner]) -> bool:
    """Return whether some of the runs were trained for other numbers of env steps than others."""
    return len({steps for learner in found for steps in learner.env_steps}) > 1


def gain(aware: Learner, unaware: Learner) -> tuple[str, str]:
    """Return the relative gain of the first in mean forward reward, and the classes in which it is ahead."""
    ours, theirs = (one.scores().rewards.mean(axis=0) for one in (aware, unaware))
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
    scores = first.scores()
    tiles = [(rounded(scores.rewards.mean()), f"forward reward of {first.name}, {first.robot}")]
    if np.isfinite(scores.speed):
        tiles.append((f"{rounded(scores.speed, 2)} m/s", f"mean forward speed of {first.name}"))
    if pairs:
        relative, ahead = gain(*pairs[0])
        differs = ", budgets differ" if budget_differs(pairs[0]) else ""
        if relative != "n/a":
            tiles.append(
                (relative, f"forward reward of {first.name} compared with {pairs[0][1].name}{differs}")
            )
        tiles.append((ahead, f"damage classes in which {first.name} is ahead"))
    return tiles


def _learners(found: Sequence[Learner], seconds: Mapping[str, float | None]) -> Values:
    # Settings in the name need no column.
    has_settings = any(learner.settings not in learner.name for learner in found)
    has_seeds = any(len(learner.evaluated()) > 1 for learner in found)
    header = ["learner", "robot", *(["settings"] if has_settings else []), "reward", "seeds", "env steps"]
    header += ["forward reward", *(["lowest seed", "highest seed"] if has_seeds else [])]
    header += ["m/s", "m per episode"]
    rows = []
    for learner in found:
        row: list[str | Cell] = [Cell(learner.name, mark(learner.place)), learner.robot]
        row += [learner.settings] if has_settings else []
        row += [learner.reward, f"{len(learner.runs)}", _steps(learner.env_steps, found, learner.robot)]
        if learner.evaluated():
            scores = learner.scores()
            seeds, second = scores.rewards.mean(axis=1), seconds[learner.robot]
            error = scores.of_groups().over_seeds()[1][-1]
            row += [f"{rounded(seeds.mean())} ± {rounded(error)}"]
            row += [rounded(seeds.min()), rounded(seeds.max())] if has_seeds else []
            row += [rounded(scores.speed, 2), rounded(None if second is None else seeds.mean() * second)]
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
