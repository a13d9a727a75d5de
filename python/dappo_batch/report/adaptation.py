"""Sections about damage during an episode: outcomes of `adapt`, and single episodes step by step."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from dappo_batch.report.figures import adaptation as figures
from dappo_batch.report.names import short_names
from dappo_batch.report.page import Section, Values
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
    picture = figures.kept(runs, [names[run.path] for run in runs])
    return Section(
        "adaptation", "Damage during an episode", (Values(header, rows),), [picture] if picture else ()
    )


def episodes(traces: Sequence[Trace]) -> Section:
    """Return single episodes; those with the same damage share a figure."""
    names = short_names([trace.path for trace in traces])
    together: dict[tuple[int | None, str], list[Trace]] = {}
    for trace in traces:
        together.setdefault((trace.onset, trace.damage), []).append(trace)
    pictures = [
        figures.walks(group, [names[trace.path] for trace in group], f"walk-{number}")
        for number, group in enumerate(together.values())
    ]
    rows = [_outcome(trace, names[trace.path]) for trace in traces]
    events = [
        (names[trace.path], f"{trace.table['step'][row]}", what, given)
        for trace in traces
        for row, what, given in _events(trace)
    ]
    header = ("episode", "damage", "onset", "suspected", "given to the policy at the end", "m/s", "file")
    parts = [Values(header, rows)]
    if events:
        of_event = ("episode", "env step", "event", "class given to the policy")
        parts.append(Values(of_event, events, "All events"))
    return Section("walks", "Single episodes", parts, pictures)


def _outcome(trace: Trace, name: str) -> tuple[str, ...]:
    """Return an episode as a row: steps, the class at the end, and the mean speed after the onset, m/s."""
    table, onset = trace.table, trace.onset or 0
    suspected = [table["step"][row] for row, what, _ in trace.events() if what.startswith("suspected")]
    start = "n/a" if trace.onset is None else f"{table['step'][onset]}"
    first = f"{suspected[0]}" if suspected else "n/a"
    speed = rounded(float(table["forward_velocity"][onset:].mean()), 2)
    return (name, trace.damage, start, first, str(table["assumed"][-1]), speed, str(trace.path))


def _events(trace: Trace) -> list[tuple[int, str, str]]:
    events = trace.events()
    if trace.onset is not None:
        onset = (trace.onset, f"damage: {trace.damage}", str(trace.table["assumed"][trace.onset]))
        events = sorted([onset, *events], key=lambda event: event[0])
    return events
