"""Collect trainings of a task with commands: how well they track, over env steps and seconds of training.

Usage: ``python docs/results/tracking.py NAME RUN...`` writes ``docs/results/NAME/tracking.csv``, a row for
each run and tenth of its iterations. It needs only Python.
"""

from __future__ import annotations

import argparse
import csv
import json
import tomllib
from collections.abc import Iterator
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
COLUMNS = ("seed", "env_steps", "seconds", "track_lin_vel", "track_ang_vel", "fall_rate", "episode_length")
SPANS = 10


def rows(run: Path) -> Iterator[tuple[float | str, ...]]:
    """Yield the means over equal spans of iterations; terms of the reward are divided by their weights."""
    seed = tomllib.loads((run / "config.toml").read_text())["seed"]
    rewards = tomllib.loads((run / "robot" / "robot.toml").read_text())["rewards"]
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    seconds = 0.0
    for span in range(SPANS):
        part = lines[len(lines) * span // SPANS : len(lines) * (span + 1) // SPANS]
        seconds += sum(line["rollout_seconds"] + line["update_seconds"] for line in part)
        tracking = [
            sum(line[f"reward_{term}"] for line in part) / len(part) / rewards[term]["weight"]
            for term in ("track_lin_vel", "track_ang_vel")
        ]
        # Means over episodes count as often as episodes ended.
        ended = sum(line["episodes"] for line in part)
        of_episodes = [
            sum((line[key] or 0.0) * line["episodes"] for line in part) / ended if ended else float("nan")
            for key in ("fall_rate", "episode_length")
        ]
        numbers = (*tracking, *of_episodes)
        yield seed, part[-1]["env_steps"], f"{seconds:.1f}", *(f"{number:.3f}" for number in numbers)


def main() -> None:
    """Write the table."""
    parser = argparse.ArgumentParser(description="Collect trainings of a task with commands.")
    parser.add_argument("name")
    parser.add_argument("runs", nargs="+", type=Path)
    asked = parser.parse_args()
    folder = FOLDER / asked.name
    folder.mkdir(exist_ok=True)
    with (folder / "tracking.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow(COLUMNS)
        for run in asked.runs:
            table.writerows(rows(run))


if __name__ == "__main__":
    main()
