"""Sections about diagnosers: Table 1 of a sweep, training, evaluations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dappo_batch.report.figures import diagnosis as figures
from dappo_batch.report.names import short_names
from dappo_batch.report.page import Section, Values
from dappo_batch.report.sources import Diagnoser, DiagnoserTest, Table1
from dappo_batch.report.words import grouped_digits, percent

__all__ = ["diagnosers", "tables"]

_MISTAKES = 8
"""Number of the most frequent misclassifications to list."""


def tables(found: Sequence[Table1]) -> Section:
    """Return the accuracies of sweeps."""
    pictures = [figures.table1(one, f"table1-{number}") for number, one in enumerate(found)]
    return Section("table1", "Table 1: accuracy of the diagnosis", (), pictures)


def diagnosers(found: Sequence[Diagnoser]) -> Section:
    """Return training and evaluations of diagnosers."""
    names = short_names([diagnoser.path for diagnoser in found])
    header = (
        "diagnoser",
        "method",
        "steps",
        "data",
        "windows",
        "accuracy",
        "±",
        "calibration error",
        "folder",
    )
    rows, mistakes = [], []
    pictures = [figures.epochs(found, [names[diagnoser.path] for diagnoser in found])]
    for number, diagnoser in enumerate(found):
        own, config = names[diagnoser.path], diagnoser.config
        for place, test in enumerate(diagnoser.tests):
            summary = (test.summary.get(key) for key in ("accuracy", "standard_error", "calibration_error"))
            rows.append(
                (
                    *(own, str(config["method"]), str(config.get("timesteps", "n/a")), test.data),
                    *(grouped_digits(int(test.confusion.sum())), *map(percent, summary), str(diagnoser.path)),
                )
            )
            pictures.append(figures.confusion(test, f"confusion-{number}-{place}", f"{own} on {test.data}"))
            mistakes += [(own, test.data, *mistake) for mistake in _worst(test)]
    parts = [Values(header, rows)] if rows else []
    if mistakes:
        columns = (
            "diagnoser",
            "data",
            "true class",
            "predicted class",
            "share of the windows of the true class",
        )
        parts.append(Values(columns, mistakes, "Most frequent misclassifications"))
    shown = [picture for picture in pictures if picture is not None]
    return Section("diagnosis", "Diagnosis", parts, shown)


def _worst(test: DiagnoserTest) -> list[tuple[str, str, str]]:
    """Return the most frequent misclassifications: true class, predicted class, share of the windows."""
    share = test.confusion / np.maximum(test.confusion.sum(axis=1, keepdims=True), 1.0)
    np.fill_diagonal(share, 0.0)
    order = np.argsort(-share, axis=None, kind="stable")[:_MISTAKES]
    places = [np.unravel_index(index, share.shape) for index in order]
    return [
        (test.names[true], test.names[predicted], percent(share[true, predicted]))
        for true, predicted in places
        if share[true, predicted] > 0
    ]
