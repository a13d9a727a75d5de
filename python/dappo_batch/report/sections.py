"""From what was read to the sections of the page."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from dappo_batch.report.figures import adaptation, diagnosis, evaluation, training
from dappo_batch.report.learners import AWARE, UNAWARE, Learner, learners
from dappo_batch.report.page import Code, Section, Text, Values
from dappo_batch.report.picture import Picture
from dappo_batch.report.sources import Diagnoser, DiagnoserTest, Sources, Sweep, Trace
from dappo_batch.runs import Run
from dappo_batch.runs.tables import read_text

__all__ = ["sections"]

# Columns of the metrics that are drawn: title, unit, and whether they are means over episodes.
_CURVES = {
    "forward_reward": ("Forward reward", "m/s, summed over steps", True),
    "episode_return": ("Return", "reward, summed over steps", True),
    "fall_rate": ("Falls", "share of episodes", True),
    "explained_variance": ("Explained variance of the returns", "share", False),
    "entropy": ("Entropy of the policy", "nats", False),
    "kl": ("KL divergence of an update", "nats", False),
}
_MISTAKES = 8
"""Most frequent mistakes of a diagnoser that are listed."""


def sections(sources: Sources) -> list[Section]:
    """Draw everything; sections without data are left out."""
    found = learners(sources.runs)
    robots = list(dict.fromkeys(learner.robot for learner in found))
    pages = [_overview(found)] if found else []
    for robot in robots:
        pages += _of_robot(robot, [learner for learner in found if learner.robot == robot])
    if adapted := [run for learner in found for run in learner.runs if run.adaptation is not None]:
        pages.append(_adaptation(adapted, found))
    if sources.traces:
        pages.append(_traces(sources.traces))
    if sources.sweeps:
        pages.append(_sweeps(sources.sweeps))
    if sources.diagnosers:
        pages.append(_diagnosers(sources.diagnosers))
    if found:
        pages.append(_throughput(robots, found))
        pages.append(_versions(found))
    return pages


def _overview(found: Sequence[Learner]) -> Section:
    header = ("robot", "learner", "reward", "seeds", "env steps", "forward reward", "lowest", "highest")
    rows = []
    for learner in found:
        steps = max(int(run.metrics["env_steps"][-1]) for run in learner.runs)
        means = learner.forward_rewards().mean(axis=1) if learner.evaluated() else np.array([])
        spread = (means.mean(), means.min(), means.max()) if len(means) else (np.nan,) * 3
        number = f"{len(learner.runs)}"
        rows.append(
            (
                *(learner.robot, learner.name, learner.reward, number, _count(steps)),
                *map(_number, spread),
            )
        )
    text = (
        "Forward reward is the sum of the forward velocity (m/s) over the steps of an episode, here the mean "
        "over all damage classes after training, without exploration noise; mean, lowest and highest seed."
    )
    return Section("overview", "Overview", (Text(text), Values(header, rows)))


def _of_robot(robot: str, found: Sequence[Learner]) -> list[Section]:
    curves = [
        training.curves(robot, found, column, title, unit, weighted=weighted)
        for column, (title, unit, weighted) in _CURVES.items()
    ]
    drawn = [picture for picture in curves if picture is not None]
    pages = [Section(f"{robot}-training", f"{robot}: training", (), drawn)]
    comparable = _comparable([learner for learner in found if learner.evaluated()])
    if not comparable:
        return pages
    pairs = [
        (one, other)
        for one in comparable
        for other in comparable
        if (one.kind, other.kind) == (AWARE, UNAWARE) and one.reward == other.reward
    ]
    pictures: list[Picture | None] = [
        evaluation.against(robot, *pair, number) for number, pair in enumerate(pairs)
    ]
    pictures += [evaluation.groups(robot, comparable), evaluation.encodings(robot, comparable)]
    parts = [_gains(pairs)] if pairs else []
    title = f"{robot}: DA-PPO and PPO-Unaware" if pairs else f"{robot}: groups of damage"
    shown = [picture for picture in pictures if picture is not None]
    pages.append(Section(f"{robot}-evaluation", title, (*parts, _group_means(comparable)), shown))
    bars = evaluation.classes(robot, comparable)
    pages.append(Section(f"{robot}-classes", f"{robot}: damage classes", (), bars))
    return pages


def _comparable(found: Sequence[Learner]) -> list[Learner]:
    """Return the learners whose damage classes are those of the first; others cannot stand beside them."""

    def names(learner: Learner) -> list[list[str]]:
        return [run.per_class["true"]["name"].tolist() for run in learner.evaluated()]

    same = names(found[0])[0] if found else []
    return [learner for learner in found if all(own == same for own in names(learner))]


def _gains(pairs: Sequence[tuple[Learner, Learner]]) -> Values:
    header = ("learner", "mean", "against", "mean", "gain", "classes ahead")
    rows = []
    for aware, unaware in pairs:
        ours, theirs = (one.forward_rewards().mean(axis=0) for one in (aware, unaware))
        gain = f"{100 * (ours.mean() / theirs.mean() - 1):+.1f} %" if theirs.mean() > 0 else "n/a"
        ahead = f"{int((ours > theirs).sum())} of {len(ours)}"
        rows.append(
            (aware.label(), _number(ours.mean()), unaware.label(), _number(theirs.mean()), gain, ahead)
        )
    return Values(header, rows)


def _group_means(found: Sequence[Learner]) -> Values:
    means = [evaluation.means_of_groups(learner) for learner in found]
    rows = [(group, *(_number(of[group].mean()) for of in means)) for group in means[0]]
    return Values(("group", *(learner.name for learner in found)), rows, "Numbers of the groups")


def _adaptation(runs: Sequence[Run], found: Sequence[Learner]) -> Section:
    names = {id(run): learner.name for learner in found for run in learner.runs}
    labels = [f"{Path(run.robot).stem} {names[id(run)]}, seed {run.seed}" for run in runs]
    header = (
        *("run", "damaged episodes", "detected", "first diagnosis right", "right in the end", "recovered"),
        "healthy episodes without alarm",
    )
    rows = []
    for label, run in zip(labels, runs, strict=True):
        table = run.adaptation or {}
        damaged = table["class"] != 0
        episodes = table["episodes"][damaged].sum()
        counted = ("detected", "right_at_first", "right_at_last", "recovered")
        shares = [
            _share(table[name][damaged].sum(), episodes) if name in table else "n/a" for name in counted
        ]
        healthy = table["episodes"][~damaged].sum()
        quiet = healthy - table["false_alarms"][~damaged].sum() if "false_alarms" in table else np.nan
        rows.append((label, f"{int(episodes)}", *shares, _share(quiet, healthy)))
    picture = adaptation.kept(runs, labels)
    return Section("adaptation", "Damage in mid-walk", (Values(header, rows),), (picture,))


def _traces(traces: Sequence[Trace]) -> Section:
    together: dict[tuple[int | None, str], list[Trace]] = {}
    for trace in traces:
        together.setdefault((trace.onset, trace.damage), []).append(trace)
    pictures = [adaptation.walks(group, f"walk-{number}") for number, group in enumerate(together.values())]
    rows = [
        (trace.path.stem, f"{trace.table['step'][row]}", what, told)
        for trace in traces
        for row, what, told in _story(trace)
    ]
    return Section("walks", "Walks", (Values(("trace", "step", "event", "told"), rows),), pictures)


def _story(trace: Trace) -> list[tuple[int, str, str]]:
    events = trace.events()
    if trace.onset is not None:
        struck = (trace.onset, f"damage: {trace.damage}", str(trace.table["told"][trace.onset]))
        events = sorted([struck, *events], key=lambda event: event[0])
    return events


def _sweeps(sweeps: Sequence[Sweep]) -> Section:
    pictures = [diagnosis.table1(sweep, f"table1-{number}") for number, sweep in enumerate(sweeps)]
    return Section("table1", "Table 1: accuracy of the diagnosis", (), pictures)


def _diagnosers(found: Sequence[Diagnoser]) -> Section:
    header = (
        "diagnoser",
        "input",
        "steps",
        "data",
        "windows",
        "accuracy",
        "± standard error",
        "calibration error",
    )
    rows, pictures, mistakes = [], [diagnosis.epochs(found)], []
    for number, diagnoser in enumerate(found):
        own, config = diagnoser.path.name, diagnoser.config
        for place, test in enumerate(diagnoser.tests):
            summary = [
                _percent(test.summary.get(key)) for key in ("accuracy", "standard_error", "calibration_error")
            ]
            windows = f"{int(test.confusion.sum())}"
            rows.append(
                (
                    own,
                    str(config["method"]),
                    str(config.get("timesteps", "n/a")),
                    test.data,
                    windows,
                    *summary,
                )
            )
            title = f"{own} on {test.data}"
            pictures.append(diagnosis.confusion(test, f"confusion-{number}-{place}", title))
            mistakes += [(own, test.data, *mistake) for mistake in _worst(test)]
    parts = [Values(header, rows)] if rows else []
    if mistakes:
        columns = ("diagnoser", "data", "true class", "named", "share of its windows")
        parts.append(Values(columns, mistakes, "Most frequent mistakes"))
    shown = [picture for picture in pictures if picture is not None]
    return Section("diagnosis", "Diagnosis", parts, shown)


def _worst(test: DiagnoserTest) -> list[tuple[str, str, str]]:
    """Return the most frequent mistakes: true class, named class, share of the windows of the true one."""
    share = test.confusion / np.maximum(test.confusion.sum(axis=1, keepdims=True), 1.0)
    np.fill_diagonal(share, 0.0)
    order = np.argsort(-share, axis=None, kind="stable")[:_MISTAKES]
    places = [np.unravel_index(index, share.shape) for index in order]
    return [
        (test.names[true], test.names[named], _percent(share[true, named]))
        for true, named in places
        if share[true, named] > 0
    ]


def _throughput(robots: Sequence[str], found: Sequence[Learner]) -> Section:
    pictures = [
        training.throughput(robot, [learner for learner in found if learner.robot == robot])
        for robot in robots
    ]
    return Section("throughput", "Throughput", (), pictures)


def _versions(found: Sequence[Learner]) -> Section:
    keys = ("version", "mujoco", "backend", "precision", "device", "physics", "threads", "platform")
    rows = [
        (
            *(run.path.name, learner.name, str(run.seed)),
            *("n/a" if (value := getattr(run.meta, key)) is None else str(value) for key in keys),
        )
        for learner in found
        for run in learner.runs
    ]
    files = [
        Code(
            f"{learner.robot}, {learner.name}: config.toml of seed {learner.runs[0].seed}",
            read_text(learner.runs[0].path / "config.toml"),
        )
        for learner in found
    ]
    return Section(
        "versions", "Configuration and versions", (Values(("run", "learner", "seed", *keys), rows), *files)
    )


def _number(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "n/a"


def _count(value: int) -> str:
    return f"{value:,}".replace(",", " ")


def _share(part: float, whole: float) -> str:
    return f"{100 * part / whole:.1f} %" if whole > 0 and np.isfinite(part) else "n/a"


def _percent(share: float | None) -> str:
    return "n/a" if share is None else f"{100 * share:.2f} %"
