"""The sections of the page from the inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from dappo_batch.report import adaptation, benchmark, diagnosis
from dappo_batch.report.figures import evaluation, training
from dappo_batch.report.learners import Learner, learners, matched
from dappo_batch.report.names import short_names
from dappo_batch.report.overview import budget_differs, gain, overview
from dappo_batch.report.page import Cell, Code, Note, Part, Section, Values
from dappo_batch.report.picture import Picture
from dappo_batch.report.score import score_of
from dappo_batch.report.sources import Outside, Sources
from dappo_batch.report.specialists import separated
from dappo_batch.report.strips import strips
from dappo_batch.report.theme import mark
from dappo_batch.report.units import step_seconds
from dappo_batch.report.words import rounded
from dappo_batch.runs import Run
from dappo_batch.runs.tables import read_text

__all__ = ["benchmark_table", "sections"]

# Columns of the metrics that are drawn after those of the score: title, unit, and whether they are means over
# episodes.
_CURVES = {
    "episode_return": ("Return", "sum of rewards", True),
    "fall_rate": ("Falls", "share of episodes", True),
    "explained_variance": ("Explained variance of the returns", "share", False),
    "entropy": ("Entropy of the policy", "nats", False),
    "kl": ("KL divergence of an update", "nats", False),
}
_REWARD_TERM = "reward_"
"""Beginning of the names of columns with terms of the reward."""
_PAIRS = 4
"""Most comparisons of two learners that are drawn, class by class."""
_PLACES = {"A": "on adjacent limbs", "O": "on opposite limbs", "S": "on limbs neither adjacent nor opposite"}


def sections(sources: Sources, *, with_strips: bool) -> list[Section]:
    """Return all sections that have data."""
    found = learners(separated(sources.runs)[0])
    names = short_names([run.path for learner in found for run in learner.runs])
    robots = list(dict.fromkeys(learner.robot for learner in found))
    seconds = {robot: _seconds([each for each in found if each.robot == robot]) for robot in robots}
    pages = [overview(found, names, seconds, sources.notes)] if found else []
    for robot in robots:
        own = [learner for learner in found if learner.robot == robot]
        pages += _of_robot(robot, own, seconds[robot], sources, with_strips=with_strips)
    if adapted := [run for learner in found for run in learner.runs if run.adaptation is not None]:
        pages.append(adaptation.outcomes(adapted, names))
    if sources.traces:
        pages.append(adaptation.episodes(sources.traces))
    if sources.tables:
        pages.append(diagnosis.tables(sources.tables))
    if sources.diagnosers:
        pages.append(diagnosis.diagnosers(sources.diagnosers))
    if found:
        figures = [
            training.throughput(robot, [learner for learner in found if learner.robot == robot])
            for robot in robots
        ]
        pages.append(Section("throughput", "Throughput", (), figures))
        pages.append(_versions(found, names))
    return pages


def _seconds(found: Sequence[Learner]) -> float | None:
    """Return the duration of an env step, s, for learners whose score times it is a distance in m.

    None if it is unknown or differs.
    """
    if not all(learner.score.is_distance for learner in found):
        return None
    durations = {step_seconds(run) for learner in found for run in learner.runs}
    return durations.pop() if len(durations) == 1 else None


def _of_robot(
    robot: str, found: Sequence[Learner], seconds: float | None, sources: Sources, *, with_strips: bool
) -> list[Section]:
    score = found[0].score  # all learners of a robot have the same
    curves = [
        training.curves(
            *(robot, found, score.column, score.title, score.unit),
            weighted=score.over_episodes,
            over="episodes that ended" if score.over_episodes else "env steps",
            seconds=seconds,
        ),
        training.curves(
            *(robot, found, score.evaluation_column, f"{score.title} of evaluations", score.unit),
            weighted=False,
            seconds=seconds,
        ),
        *(
            training.curves(
                *(robot, found, column, title, unit),
                weighted=weighted,
                over="episodes that ended" if weighted else "",
            )
            for column, (title, unit, weighted) in _CURVES.items()
        ),
    ]
    drawn = [picture for picture in curves if picture is not None]
    pages = [Section(f"{robot}-training", f"{robot}: training", (), drawn)]
    if terms := _reward_terms(robot, found):
        pages.append(Section(f"{robot}-reward", f"{robot}: terms of the reward", (), terms))
    comparable = _comparable([learner for learner in found if learner.evaluated()])
    if not comparable:
        return pages
    pages.append(_benchmark(robot, comparable, sources))
    pairs = matched(comparable)
    pictures: list[Picture | None] = [
        evaluation.groups(robot, comparable, seconds),
        *(evaluation.against(robot, *pair, number) for number, pair in enumerate(pairs[:_PAIRS])),
        evaluation.encodings(robot, comparable, seconds),
    ]
    shown = [picture for picture in pictures if picture is not None]
    parts: list[Part] = [*([_gains(pairs)] if pairs else []), _groups(comparable)]
    if len(pairs) > _PAIRS:
        parts.append(Note(f"Figures show the first {_PAIRS} of {len(pairs)} comparisons of the table."))
    pages.append(Section(f"{robot}-evaluation", f"{robot}: evaluation", parts, shown))
    bars = evaluation.classes(robot, comparable, seconds)
    pages.append(Section(f"{robot}-classes", f"{robot}: damage classes", (), bars))
    if with_strips:
        pages.append(Section(f"{robot}-strips", f"{robot}: film strips", strips(comparable)))
    return pages


def _benchmark(robot: str, found: Sequence[Learner], sources: Sources) -> Section:
    entries = _entries(found, sources)
    pictures = [evaluation.profile(robot, entries)] if entries[0].shares is not None else []
    shown = {entry.name for entry in entries}
    notes: list[Part] = [
        Note(f"{each.name} is not in the tables: it was evaluated with other damage classes.")
        for each in _outside(found, sources)
        if each.name not in shown
    ]
    parts = benchmark.parts(entries, _specialists(found, sources), found[0].score)
    return Section(f"{robot}-benchmark", f"{robot}: benchmark", [*notes, *parts], pictures)


def _entries(found: Sequence[Learner], sources: Sources) -> list[benchmark.Entry]:
    return benchmark.entries(found, _outside(found, sources), _specialists(found, sources))


def _outside(found: Sequence[Learner], sources: Sources) -> list[Outside]:
    return [each for each in sources.outside if _is_of(each.run, found)]


def _specialists(found: Sequence[Learner], sources: Sources) -> list[Run]:
    return [run for run in separated(sources.runs)[1] if _is_of(run, found)]


def _is_of(run: Run, found: Sequence[Learner]) -> bool:
    """Return whether a run is one of the same robot as those of learners, and compared by the same score."""
    first = found[0].runs[0]
    return Path(run.robot).stem == Path(first.robot).stem and score_of(run) == found[0].score


def benchmark_table(sources: Sources) -> str:
    """Return the tables of all benchmarks as one CSV."""
    evaluated = [learner for learner in learners(separated(sources.runs)[0]) if learner.evaluated()]
    robots = dict.fromkeys(learner.robot for learner in evaluated)
    rows = []
    for robot in robots:
        found = _comparable([learner for learner in evaluated if learner.robot == robot])
        rows.append((robot, found[0].score, _entries(found, sources)))
    return benchmark.table(rows)


def _reward_terms(robot: str, found: Sequence[Learner]) -> list[Picture]:
    """Return a figure for each term of the rewards, in the order of their names."""
    names = {column for learner in found for run in learner.runs for column in run.metrics}
    columns = sorted(name for name in names if name.startswith(_REWARD_TERM))
    pictures = (
        training.curves(
            *(robot, found, column, f"reward term {column.removeprefix(_REWARD_TERM)}", "per step, weighted"),
            weighted=False,
        )
        for column in columns
    )
    return [picture for picture in pictures if picture is not None]


def _comparable(found: Sequence[Learner]) -> list[Learner]:
    """Return the learners whose damage classes are those of the first; others cannot be compared."""

    def names(learner: Learner) -> list[list[str]]:
        return [run.per_class["true"]["name"].tolist() for run in learner.evaluated()]

    same = names(found[0])[0] if found else []
    return [learner for learner in found if all(own == same for own in names(learner))]


def _gains(pairs: Sequence[tuple[Learner, Learner]]) -> Values:
    score = pairs[0][0].score
    header = (
        "learner",
        score.name,
        "compared with",
        score.name,
        "gain",
        "classes ahead",
        "budgets",
    )
    rows = [
        (
            *(Cell(aware.label(), mark(aware.place)), _mean(aware)),
            *(Cell(unaware.label(), mark(unaware.place)), _mean(unaware)),
            *gain(aware, unaware),
            Cell("differ", is_flagged=True) if budget_differs((aware, unaware)) else "equal",
        )
        for aware, unaware in pairs
    ]
    return Values(header, rows)


def _mean(learner: Learner) -> str:
    """Return the mean score over all damage classes and seeds as text."""
    return rounded(learner.scores().values.mean(), learner.score.digits)


def _groups(found: Sequence[Learner]) -> Values:
    """Return the groups of damage classes, and the learners' mean scores in them."""
    digits = found[0].score.digits
    classes = found[0].scores()
    means = [learner.scores().of_groups() for learner in found]
    over_seeds = [mean.over_seeds() for mean in means]
    header = ("group", "damage", "classes", *(learner.name for learner in found))
    rows = []
    for index, group in enumerate(means[0].names):
        members = [name for name, of in zip(classes.names, classes.groups, strict=True) if of == group]
        numbers = [
            f"{rounded(mean[index], digits)} ± {rounded(error[index], digits)}" for mean, error in over_seeds
        ]
        what = "all classes, equally weighted" if group == "all" else _explained(group, members[0])
        rows.append((group, what, f"{len(members) or len(classes.names)}", *numbers))
    return Values(header, rows)


def _explained(group: str, member: str) -> str:
    """Return the description of a group, from the name of one of its classes and its own."""
    if "@" not in member:
        return "healthy robot"
    types = sorted(part.partition("@")[0] for part in member.split("+"))
    place = _PLACES.get(group.rpartition(" ")[2], "")
    if len(types) == 1:
        return f"one limb: {types[0]}"
    return f"{len(types)} limbs: {' and '.join(types)} {place}".rstrip()


def _versions(found: Sequence[Learner], names: Mapping[Path, str]) -> Section:
    keys = ("version", "mujoco", "backend", "precision", "device", "physics", "threads", "platform")
    rows = [
        (
            *(names[run.path], learner.name, str(run.seed)),
            *("n/a" if (value := getattr(run.meta, key)) is None else str(value) for key in keys),
        )
        for learner in found
        for run in learner.runs
    ]
    files: list[Part] = [
        Code(
            f"{learner.robot}, {learner.name}: config.toml of seed {learner.runs[0].seed}",
            read_text(learner.runs[0].path / "config.toml"),
        )
        for learner in found
    ]
    return Section(
        "versions", "Configuration and versions", (Values(("run", "learner", "seed", *keys), rows), *files)
    )
