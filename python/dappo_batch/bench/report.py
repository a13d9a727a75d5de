"""What a benchmark found, as a table for people and as JSON for programs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

from dappo_batch.bench.learner import LearnerShare
from dappo_batch.bench.measure import Sample, Spread, ratios

__all__ = ["BASE", "Missing", "Report", "Result", "machine_text", "results", "table"]

BASE = "mj_step"
"""Key of the contender that all others are compared with."""

MEMORY_TARGET_MB = 300.0
"""What 4096 Ants may take, the Python process included."""


@dataclass(frozen=True)
class Missing:
    """A contender that was not measured."""

    key: str
    reason: str
    install: str

    def text(self) -> str:
        """Say what is missing, why, and what would change it."""
        cure = f"; to install it: {self.install}" if self.install else ""
        return f"not measured: {self.key}: {self.reason}{cure}"


def machine_text(machine: Mapping[str, Any]) -> str:
    """Return two lines about a machine that `describe` has described."""
    load = "unknown" if machine["load_average"] is None else f"{machine['load_average']:.2f}"
    return (
        f"{machine['cpu']}, {machine['cores']} cores, load average {load} at the start\n"
        f"mujoco {machine['mujoco']}, numpy {machine['numpy']}, Python {machine['python']}"
    )


def table(rows: Sequence[Sequence[str]]) -> str:
    """Align cells in columns: the first to the left, the others to the right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for first, *others in rows:
        cells = [first.ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(others, widths[1:], strict=True)]
        lines.append("  ".join(cells).rstrip())
    return "\n".join(lines)


@dataclass(frozen=True)
class Result:
    """One contender's numbers.

    Attributes
    ----------
    rate : Spread
        Env steps per second of elapsed time.
    cpu_us : Spread
        Processor time of an env step, µs.
    rate_ratio, cpu_ratio : Spread
        The same in terms of `BASE`, compared round by round.
    """

    key: str
    about: str
    note: str
    num_envs: int
    rate: Spread
    cpu_us: Spread
    rate_ratio: Spread
    cpu_ratio: Spread


def results(
    samples: Mapping[str, Sequence[Sample]], described: Mapping[str, tuple[str, str, int]]
) -> tuple[Result, ...]:
    """Summarise the samples of each contender; `described` holds its about, note and number of envs."""
    base = samples[BASE]
    found = []
    for key, own in samples.items():
        about, note, num_envs = described[key]
        found.append(
            Result(
                key=key,
                about=about,
                note=note,
                num_envs=num_envs,
                rate=Spread.of([sample.rate for sample in own]),
                cpu_us=Spread.of([sample.cpu_us for sample in own]),
                rate_ratio=ratios(own, base, lambda sample: sample.rate),
                cpu_ratio=ratios(own, base, lambda sample: sample.cpu_us),
            )
        )
    return tuple(found)


@dataclass(frozen=True)
class Report:
    """Everything that one call of ``dappo-batch bench`` found.

    Attributes
    ----------
    machine : dict
        Processor, cores, load average before the first sample, versions.
    settings : dict
        Robot, number of envs, threads, seconds a sample, rounds.
    results : tuple of Result
        The measured contenders.
    missing : tuple of Missing
        The others, and why.
    memory_mb : float or None
        Peak memory of a process with all envs, MB; ``None`` if it failed.
    memory_error : str
        How it failed.
    learner : LearnerShare or None
        ``None`` if it was not asked for.
    """

    machine: dict[str, Any]
    settings: dict[str, Any]
    results: tuple[Result, ...]
    missing: tuple[Missing, ...]
    memory_mb: float | None = None
    memory_error: str = ""
    learner: LearnerShare | None = field(default=None)

    def as_dict(self) -> dict[str, Any]:
        """Return everything as JSON can hold it."""
        whole = asdict(self)
        whole["base"] = BASE
        whole["learner"] = None if self.learner is None else self.learner.as_dict()
        return whole

    def text(self) -> str:
        """Return everything as a text for people."""
        parts = [self._machine(), self._table(), self._legend(), self._missing(), self._memory()]
        if self.learner is not None:
            parts.append(_learner(self.learner))
        return "\n\n".join(part for part in parts if part)

    def _machine(self) -> str:
        settings = self.settings
        return (
            f"{machine_text(self.machine)}\n"
            f"robot {settings['robot']}: {settings['num_envs']} envs, {settings['threads']} threads, "
            f"{settings['rounds']} rounds of {settings['seconds']:g} s each, medians (lowest to highest)"
        )

    def _table(self) -> str:
        head = ("", "env steps/s", "CPU µs a step", f"speed / {BASE}", f"CPU / {BASE}")
        rows = [
            (
                result.key,
                f"{result.rate.median:,.0f}",
                f"{result.cpu_us.median:.1f}",
                result.rate_ratio.text(".2f"),
                result.cpu_ratio.text(".2f"),
            )
            for result in self.results
        ]
        return table([head, *rows])

    def _legend(self) -> str:
        width = max(len(result.key) for result in self.results)
        return "\n".join(
            f"{result.key.ljust(width)}  {result.about}{f' ({result.note})' if result.note else ''}"
            for result in self.results
        )

    def _missing(self) -> str:
        return "\n".join(one.text() for one in self.missing)

    def _memory(self) -> str:
        if self.memory_mb is None:
            return f"memory: not measured: {self.memory_error}"
        return (
            f"memory: {self.memory_mb:.0f} MB at most for a whole process with "
            f"{self.settings['num_envs']} envs (the Ant's target with 4096: {MEMORY_TARGET_MB:.0f} MB)"
        )


def _learner(learner: LearnerShare) -> str:
    if learner.error:
        return f"training: not measured: {learner.error}"
    steps = learner.num_envs * learner.horizon
    total = learner.rollout_seconds + learner.update_seconds
    return (
        f"training: {steps / total:,.0f} env steps/s; an iteration of {learner.num_envs} envs x "
        f"{learner.horizon} steps collects for {learner.rollout_seconds:.2f} s and learns for "
        f"{learner.update_seconds:.2f} s (the learner's share is {learner.share:.0%})"
    )
