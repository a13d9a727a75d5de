"""Sections about damage during an episode: outcomes of `adapt`, and single episodes step by step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from dappo_batch.report.figures import adaptation as figures
from dappo_batch.report.names import short_names
from dappo_batch.report.page import Section, Values
from dappo_batch.report.score import Score, score_of
from dappo_batch.report.sources import Trace
from dappo_batch.report.words import rounded, share
from dappo_batch.runs import Run

__all__ = ["episodes", "outcomes"]

_COUNTED = {
    "detected": "detected",
    "correct_first": "first diagnosis correct",
    "correct_last": "correct class at the end",
    "recovered": "recovered",
}
"""Columns that count episodes of damaged robots, with their headings."""


def outcomes(runs: Sequence[Run], names: Mapping[Path, str]) -> Section:
    """Return the results of ``adapt --all-classes``, over all damage classes."""
    tables = [run.adaptation or {} for run in runs]
    counted = {
        column: title for column, title in _COUNTED.items() if all(column in table for table in tables)
    }
    header = ["run", "damaged episodes", *counted.values()]
    has_alarms = all("false_alarms" in table for table in tables)
    header += ["healthy episodes without alarm"] if has_alarms else []
    rows = []
    for run, table in zip(runs, tables, strict=True):
        damaged = table["class"] != 0
        episodes, healthy = table["episodes"][damaged].sum(), table["episodes"][~damaged].sum()
        row = [names[run.path], f"{int(episodes)}"]
        row += [share(table[column][damaged].sum(), episodes) for column in counted]
        row += [share(healthy - table["false_alarms"][~damaged].sum(), healthy)] if has_alarms else []
        rows.append(row)
    pictures = []
    for score in dict.fromkeys(map(score_of, runs)):
        alike = [run for run in runs if score_of(run) == score]
        pictures.append(figures.kept(alike, [names[run.path] for run in alike], score))
    shown = [picture for picture in pictures if picture is not None]
    return Section("adaptation", "Damage during an episode", (Values(header, rows),), shown)


def episodes(traces: Sequence[Trace]) -> Section:
    """Return single episodes; those with the same damage and score share a figure."""
    names = short_names([trace.path for trace in traces])
    together: dict[tuple[int | None, str, Score], list[Trace]] = {}
    for trace in traces:
        together.setdefault((trace.onset, trace.damage, trace.score), []).append(trace)
    pictures = [
        figures.walks(group, [names[trace.path] for trace in group], f"walk-{number}")
        for number, group in enumerate(together.values())
    ]
    events = [
        (names[trace.path], f"{trace.table['step'][row]}", what, given)
        for trace in traces
        for row, what, given in _events(trace)
    ]
    parts = [
        _outcomes([trace for trace in traces if trace.score == score], names, score)
        for score in dict.fromkeys(trace.score for trace in traces)
    ]
    if events:
        of_event = ("episode", "env step", "event", "class given to the policy")
        parts.append(Values(of_event, events, "All events"))
    return Section("walks", "Single episodes", parts, pictures)


def _outcomes(traces: Sequence[Trace], names: Mapping[Path, str], score: Score) -> Values:
    """Return episodes with a score in common as a table."""
    what = score.step_unit if score.is_distance else score.step_name
    header = ("episode", "damage", "onset", "suspected", "given to the policy at the end", what, "file")
    return Values(header, [_outcome(trace, names[trace.path]) for trace in traces])


def _outcome(trace: Trace, name: str) -> tuple[str, ...]:
    """Return an episode as a row; its last number is the mean speed or tracking after the onset."""
    table, onset = trace.table, trace.onset or 0
    suspected = [table["step"][row] for row, what, _ in trace.events() if what.startswith("suspected")]
    start = "n/a" if trace.onset is None else f"{table['step'][onset]}"
    first = f"{suspected[0]}" if suspected else "n/a"
    mean = rounded(float(table[trace.score.step_column][onset:].mean()), 2)
    return (name, trace.damage, start, first, str(table["assumed"][-1]), mean, str(trace.path))


def _events(trace: Trace) -> list[tuple[int, str, str]]:
    events = trace.events()
    if trace.onset is not None:
        onset = (trace.onset, f"damage: {trace.damage}", str(trace.table["assumed"][trace.onset]))
        events = sorted([onset, *events], key=lambda event: event[0])
    return events
