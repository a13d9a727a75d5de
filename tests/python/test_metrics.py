"""The metrics of a run in all their formats, as TensorBoard's own reader and the csv module read them."""

from __future__ import annotations

import csv
import json
import math
import warnings
from pathlib import Path
from typing import Any

import pytest

from .command_line import ITERATION, TINY, dappo_batch

ROUNDING = 1e-15
"""The copies are made from the text of ``metrics.jsonl``, whose numbers are read up to their last digit."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train for one iteration, then go on for two more."""
    run = tmp_path_factory.mktemp("metrics") / "run"
    dappo_batch("train", "--run", run, "--steps", str(ITERATION), *TINY)
    dappo_batch("train", "--resume", run, "--steps", str(3 * ITERATION))
    return run


def lines(run: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]


def test_tensorboard_reads_every_number_at_its_env_step_and_time(run: Path) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of TensorBoard's own imports
        from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
    events = EventAccumulator(str(run)).Reload()
    expected = lines(run)
    assert [line["env_steps"] for line in expected] == [ITERATION, 2 * ITERATION, 3 * ITERATION]
    names = {
        name
        for line in expected
        for name, value in line.items()
        if isinstance(value, int | float) and name not in {"env_steps", "unix_seconds"}
    }
    assert {"forward_reward", "policy_loss", "kl", "rollout_seconds"} <= names
    groups = {name: "time" if name.endswith("_seconds") else "metrics" for name in names}
    assert set(events.Tags()["scalars"]) == {f"{group}/{name}" for name, group in groups.items()}
    for name, group in groups.items():
        present = [line for line in expected if line[name] is not None]
        got = events.Scalars(f"{group}/{name}")
        assert [event.step for event in got] == [line["env_steps"] for line in present], name
        for event, line in zip(got, present, strict=True):
            assert math.isclose(event.wall_time, line["unix_seconds"], rel_tol=ROUNDING), name
            assert math.isclose(event.value, line[name], rel_tol=1e-6), name


def test_the_csv_file_has_a_column_for_every_metric(run: Path) -> None:
    expected = lines(run)
    with (run / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [list(row) for row in rows] == [list(line) for line in expected]
    for row, line in zip(rows, expected, strict=True):
        for name, value in line.items():
            if value is None:
                assert row[name] == ""
            elif isinstance(value, str):
                assert row[name] == value
            else:
                assert math.isclose(float(row[name]), value, rel_tol=ROUNDING)
