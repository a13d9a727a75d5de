"""All learners of a robot by what they reach over damage classes and seeds, and as shares of specialists.

Sources: Agarwal et al. (2021), "Deep reinforcement learning at the edge of the statistical precipice", whose
library is rliable, for the interquartile mean and performance profiles; Efron and Tibshirani (1993), "An
introduction to the bootstrap", for percentile intervals.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from dappo_batch.report.learners import Learner
from dappo_batch.report.page import Cell, Part, Text, Values
from dappo_batch.report.score import Score
from dappo_batch.report.sources import Outside
from dappo_batch.report.specialists import damage_of, references
from dappo_batch.report.theme import mark
from dappo_batch.report.words import grouped_digits, percent, rounded
from dappo_batch.results.evaluation import Estimate
from dappo_batch.runs import Run
from dappo_batch.runs.tables import Table

__all__ = ["Entry", "Measure", "entries", "interquartile_mean", "measure", "parts", "table"]

RESAMPLES = 10_000
_AT_ONCE = 500  # resamples, which bounds the memory
_WORST = 5
"""Damage classes of the mean over the worst ones."""
_OUTSIDE = (0.025, 0.975)
"""Ends of an interval."""

_Array = NDArray[np.float64]


@dataclass(frozen=True)
class Measure:
    """What S seeds reach in C damage classes, in a few numbers.

    Attributes
    ----------
    classes : int
        Number of classes, C.
    mean, interquartile_mean : Estimate
        Over all S · C values, with 95 % intervals; the ends are NaN for a single seed.
    worst : float
        Mean over the five lowest classes of each seed.
    lowest : float
        The lowest mean over seeds of a class.
    lowest_class : str
        Name of that class.
    """

    classes: int
    mean: Estimate
    interquartile_mean: Estimate
    worst: float
    lowest: float
    lowest_class: str


@dataclass(frozen=True)
class Entry:
    """A learner, or a policy of another one, in the order of the tables.

    Attributes
    ----------
    name : str
        Name of the learner, or of the evaluation of a policy from elsewhere.
    learner : Learner or None
        None for a policy from elsewhere.
    values : float64[S, C]
        What its seeds reach in the damage classes.
    fall_rate : float
        Share of the episodes that ended in a fall; NaN where it is unknown.
    score : Measure
        Of `values`.
    shares : float64[S, K], or None
        Shares of the K classes that have a specialist; None without specialists.
    share : Measure or None
        Of `shares`.
    """

    name: str
    learner: Learner | None
    values: _Array
    fall_rate: float
    score: Measure
    shares: _Array | None = None
    share: Measure | None = None


def interquartile_mean(values: _Array) -> _Array:
    """Return the mean over the last axis without its lowest and its highest quarter.

    As ``scipy.stats.trim_mean(values, 0.25, axis=-1)``: the number of values of a quarter is rounded down.
    """
    cut = values.shape[-1] // 4
    mean: _Array = np.sort(values, axis=-1)[..., cut : values.shape[-1] - cut].mean(axis=-1)
    return mean


def measure(values: _Array, names: Sequence[str]) -> Measure:
    """Return the measure of values, [S, C], in classes with these names.

    Intervals are percentiles over resamples of seeds with replacement. A policy for all damage classes is
    one draw, so a resample has all classes of each of its seeds; rliable, for policies of a single task each,
    draws the seeds of every task anew.
    """
    over_seeds = values.mean(axis=0)
    lowest = int(over_seeds.argmin())
    return Measure(
        values.shape[1],
        _estimate(values, lambda flat: flat.mean(axis=-1)),
        _estimate(values, interquartile_mean),
        float(np.sort(values, axis=1)[:, :_WORST].mean()),
        float(over_seeds[lowest]),
        names[lowest],
    )


def _estimate(values: _Array, statistic: Callable[[_Array], _Array]) -> Estimate:
    value = float(statistic(values.reshape(1, -1))[0])
    seeds = len(values)
    if seeds == 1:
        return Estimate(value, np.nan, np.nan)
    rng = np.random.default_rng(0)
    found = [
        statistic(values[rng.integers(seeds, size=(_AT_ONCE, seeds))].reshape(_AT_ONCE, -1))
        for _ in range(RESAMPLES // _AT_ONCE)
    ]
    low, high = np.quantile(np.concatenate(found), _OUTSIDE)
    return Estimate(value, float(low), float(high))


def entries(
    learners: Sequence[Learner], outside: Sequence[Outside], specialists: Sequence[Run]
) -> list[Entry]:
    """Return an entry for each evaluated learner, and each policy from elsewhere with the same classes."""
    names, score = learners[0].scores().names, learners[0].score
    reached = references(names, specialists, score)
    known = np.flatnonzero(reached > 0)

    def entry(name: str, learner: Learner | None, values: _Array, tables: Sequence[Table]) -> Entry:
        found = Entry(name, learner, values, _fall_rate(tables), measure(values, names))
        if not len(known):
            return found
        shares = values[:, known] / reached[known]
        return replace(found, shares=shares, share=measure(shares, [names[index] for index in known]))

    found = []
    for learner in learners:
        tables = [run.per_class["true"] for run in learner.evaluated()]
        found.append(entry(learner.name, learner, learner.scores().values, tables))
    for each in outside:
        if score.column in each.table and tuple(map(str, each.table["name"])) == names:
            values = each.table[score.column].astype(np.float64)
            found.append(entry(each.name, None, values[None], [each.table]))
    return found


def _fall_rate(tables: Sequence[Table]) -> float:
    """Return the share of the episodes that ended in a fall; NaN if a table does not contain it."""
    if not all("falls" in each for each in tables):
        return float("nan")
    falls, episodes = (sum(float(each[name].sum()) for each in tables) for name in ("falls", "episodes"))
    return falls / episodes


def parts(found: Sequence[Entry], specialists: Sequence[Run], score: Score) -> list[Part]:
    """Return the tables of a page."""
    about = (
        "Over all damage classes and seeds. The interquartile mean leaves out the lowest and the highest "
        f"quarter of all values; “worst {_WORST}” is the mean over the {_WORST} lowest classes of each seed."
    )
    if any(len(entry.values) > 1 for entry in found):
        about += " Brackets: 95 % bootstrap intervals over seeds, all classes of a seed drawn together."
    tables: list[Part] = [Text(about), _scores(found, score)]
    shared = [entry for entry in found if entry.share is not None]
    if shared:
        total = shared[0].score.classes
        classes = shared[0].share.classes if shared[0].share else 0
        tables.append(
            Text(
                "As shares of what specialists reach, policies that were trained on one damage class alone, "
                f"in {classes} of {total} classes. A class without a specialist has that of its mirror image."
            )
        )
        tables.append(_shares(shared))
        tables.append(_specialists(specialists, score))
    return tables


def _text(estimate: Estimate, digits: int, factor: float = 1.0) -> str:
    """Return an estimate as text, with its interval if there are several seeds."""
    numbers = (estimate.value, estimate.low, estimate.high)
    value, low, high = (rounded(factor * number, digits) for number in numbers)
    return f"{value} [{low}, {high}]" if np.isfinite(estimate.low) else value


def _name(entry: Entry) -> str | Cell:
    return entry.name if entry.learner is None else Cell(entry.learner.name, mark(entry.learner.place))


def _scores(found: Sequence[Entry], score: Score) -> Values:
    header = ("learner", "seeds", "env steps", "training", "mean", "interquartile mean", f"worst {_WORST}")
    rows = [
        (
            *(_name(entry), *_training(entry), _text(entry.score.mean, score.digits)),
            _text(entry.score.interquartile_mean, score.digits),
            rounded(entry.score.worst, score.digits),
            f"{rounded(entry.score.lowest, score.digits)} ({entry.score.lowest_class})",
            percent(entry.fall_rate if np.isfinite(entry.fall_rate) else None),
        )
        for entry in found
    ]
    return Values((*header, "lowest class", "falls"), rows)


def _training(entry: Entry) -> tuple[str, str, str]:
    """Return the number of seeds, env steps, and the mean time of a training as text."""
    if entry.learner is None:
        return "n/a", "n/a", "n/a"
    steps, seconds = entry.learner.env_steps, entry.learner.seconds
    return str(len(entry.values)), grouped_digits(max(steps)), f"{np.mean(seconds) / 60:.1f} min"


def _shares(found: Sequence[Entry]) -> Values:
    header = ("learner", "mean, %", "interquartile mean, %", f"worst {_WORST}, %", "lowest class, %")
    rows = [
        (
            *(_name(entry), _text(entry.share.mean, 1, 100), _text(entry.share.interquartile_mean, 1, 100)),
            rounded(100 * entry.share.worst),
            f"{rounded(100 * entry.share.lowest)} ({entry.share.lowest_class})",
        )
        for entry in found
        if entry.share is not None
    ]
    return Values(header, rows)


def _specialists(runs: Sequence[Run], score: Score) -> Values:
    rows = []
    for run in runs:
        table, damage = run.per_class["true"], damage_of(run) or frozenset()
        own = [index for index, name in enumerate(table["name"]) if frozenset(str(name).split("+")) == damage]
        reached = [rounded(float(table[score.column][index]), score.digits) for index in own]
        steps = grouped_digits(int(run.metrics["env_steps"][-1]))
        rows.append(("+".join(sorted(damage)), "".join(reached), f"{run.seed}", steps, str(run.path)))
    return Values(("damage", score.name, "seed", "env steps", "folder"), sorted(rows), "Specialists")


def table(found: Sequence[tuple[str, Score, Sequence[Entry]]]) -> str:
    """Return the entries of all robots as CSV: a row for each measure."""
    columns = [
        *("robot", "learner", "measure", "classes", "seeds", "env_steps", "training_seconds"),
        *("mean", "mean_low", "mean_high"),
        *("interquartile_mean", "interquartile_mean_low", "interquartile_mean_high"),
        *("worst_five", "lowest", "lowest_class", "fall_rate"),
    ]
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(columns)
    for robot, score, rows in found:
        for entry in rows:
            learner = entry.learner
            steps = max(learner.env_steps) if learner else ""
            seconds = _number(float(np.mean(learner.seconds)), 1) if learner else ""
            for name, each in ((score.column, entry.score), ("share_of_specialist", entry.share)):
                if each is None:
                    continue
                numbers = [
                    getattr(of, end)
                    for of in (each.mean, each.interquartile_mean)
                    for end in ("value", "low", "high")
                ]
                writer.writerow(
                    [
                        *(robot, entry.name, name, each.classes, len(entry.values), steps, seconds),
                        *(_number(number) for number in (*numbers, each.worst, each.lowest)),
                        *(each.lowest_class, _number(entry.fall_rate)),
                    ]
                )
    return file.getvalue()


def _number(value: float, digits: int = 4) -> str:
    return f"{value:.{digits}f}" if np.isfinite(value) else ""
