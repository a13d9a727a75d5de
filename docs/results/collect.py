"""Collect runs into the tables and the picture of a results page.

Usage: ``python docs/results/collect.py NAME RUN...`` writes ``docs/results/NAME/``, where runs of other
learners and seeds stay:

- ``per_class.csv``: the evaluations of all runs, one row for each run and damage class;
- ``curves.csv``: forward reward over env steps and seconds of training, in equal spans of env steps;
- ``curves.svg``: the curves, a line for the mean over the seeds of a learner and a band from the lowest to
  the highest seed.

Of a task with commands only the evaluations are collected; the curves are those of ``tracking.py``.

It needs only Python.
"""

from __future__ import annotations

import argparse
import csv
import json
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import mean
from typing import Any

from curves import ENV_STEPS, picture

FOLDER = Path(__file__).resolve().parent
SPANS = 50
"""Points of a curve."""


@dataclass(frozen=True)
class Run:
    """One training run: its learner and its files."""

    learner: str
    seed: int
    points: list[dict[str, float]]
    classes: list[dict[str, str]]

    @property
    def commanded(self) -> bool:
        """Whether the task has commands, which the evaluation measures the tracking of."""
        return bool(self.classes[0].get("tracking"))


def main() -> None:
    """Write the tables and the picture."""
    parser = argparse.ArgumentParser(description="Collect runs into the tables of a results page.")
    parser.add_argument("name")
    parser.add_argument("runs", nargs="*", type=Path)
    asked = parser.parse_args()
    target = FOLDER / asked.name
    target.mkdir(exist_ok=True)
    found = {(run.learner, run.seed): run for run in [*collected(target), *map(read, asked.runs)]}
    runs = [found[key] for key in sorted(found)]
    write(target / "per_class.csv", (tag(run) | row for run in runs for row in run.classes))
    if any(run.commanded for run in runs):
        for run in runs:
            tracking = mean(float(row["tracking"]) for row in run.classes)
            print(f"{run.learner}, seed {run.seed}: {tracking:.3f}")
        return
    write(target / "curves.csv", (tag(run) | rounded(point) for run in runs for point in run.points))
    learners: dict[str, list[list[dict[str, float]]]] = defaultdict(list)
    for run in runs:
        learners[run.learner].append(run.points)
    (target / "curves.svg").write_text(picture(learners, ENV_STEPS), encoding="utf-8")
    for run in runs:
        reward = mean(float(row["forward_reward"]) for row in run.classes)
        print(f"{run.learner}, seed {run.seed}: {reward:.1f} in {run.points[-1]['seconds']:.0f} s")


def collected(target: Path) -> Iterator[Run]:
    """Read the runs of the tables that are there."""
    tables = [target / "per_class.csv", target / "curves.csv"]
    if not tables[0].exists():
        return
    classes, points = (grouped(table) if table.exists() else defaultdict(list) for table in tables)
    for (name, seed), rows in classes.items():
        curve = [{key: float(value) for key, value in row.items()} for row in points[name, seed]]
        yield Run(name, int(seed), curve, rows)


def grouped(path: Path) -> dict[tuple[str, str], list[dict[str, str]]]:
    """Read a table as the rows of each learner and seed."""
    groups: dict[tuple[str, str], list[dict[str, str]]] = defaultdict(list)
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            groups[row.pop("learner"), row.pop("seed")].append(row)
    return groups


def read(folder: Path) -> Run:
    """Read a run folder."""
    config = tomllib.loads((folder / "config.toml").read_text(encoding="utf-8"))
    lines = [json.loads(line) for line in (folder / "metrics.jsonl").read_text(encoding="utf-8").splitlines()]
    with (folder / "eval" / "per_class.csv").open(encoding="utf-8", newline="") as file:
        classes = list(csv.DictReader(file))
    return Run(learner(config), config["seed"], curve(lines, config["total_steps"]), classes)


def learner(config: dict[str, Any]) -> str:
    """Return the name of the learner; the scale of an unobserved code is left out."""
    others = ", symmetric" if config["ppo"].get("symmetry", False) else ""
    if steps := config["damage"].get("min_class_steps"):
        others += f", {steps} steps a class"
    if steps := config["env"].get("history"):
        others += f", history of {steps} steps"
    if units := config["ppo"].get("lstm"):
        others += f", LSTM of {units} units"
    if not config["env"]["observe_damage"]:
        return f"PPO-Unaware{others}"
    return f"DA-PPO, code scale {config['ppo'].get('code_scale', 1):g}{others}"


def curve(lines: Iterable[dict[str, Any]], total_steps: int) -> list[dict[str, float]]:
    """Average the episodes that ended within each span of env steps."""
    points: list[dict[str, float]] = []
    seconds = episodes = reward = 0.0
    for line in lines:
        seconds += line["rollout_seconds"] + line["update_seconds"]
        episodes += line["episodes"]
        reward += line["episodes"] * (line["forward_reward"] or 0.0)
        if line["env_steps"] >= (len(points) + 1) * total_steps / SPANS and episodes:
            point = {"env_steps": line["env_steps"], "seconds": seconds, "forward_reward": reward / episodes}
            points.append(point)
            episodes = reward = 0.0
    return points


def tag(run: Run) -> dict[str, Any]:
    """Identify the run in a row of a table."""
    return {"learner": run.learner, "seed": run.seed}


def rounded(point: dict[str, float]) -> dict[str, Any]:
    """Drop insignificant digits."""
    digits = {key: round(point[key], 1) for key in ("seconds", "forward_reward")}
    return {"env_steps": int(point["env_steps"])} | digits


def write(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    """Write a table with the columns that all rows have, which were fewer in earlier versions."""
    table = list(rows)
    columns = [column for column in table[0] if all(column in row for row in table)]
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, columns, extrasaction="ignore", lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)


if __name__ == "__main__":
    main()
