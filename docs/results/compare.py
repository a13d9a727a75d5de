"""Compare two learners of a results page, from its table.

Usage: ``python docs/results/compare.py [--column tracking] [--learners A B] NAME [SEED...]`` reads
``docs/results/NAME/per_class.csv`` and prints, for all seeds or for those given, the mean of a column (by
default the forward reward) for each learner, the gain of the first over the second (by default of DA-PPO over
PPO-Unaware) with its interval, the classes in which it is ahead, and the groups of damage classes.

Intervals are those of ``dappo-batch evaluate --compare``: 95 % percentile intervals of 10 000 resamples of
classes, the same for both learners, and of seeds, for each learner by itself. The draws differ, and so does
the last digit. It needs only Python.
"""

from __future__ import annotations

import argparse
import csv
import random
from collections import defaultdict
from pathlib import Path
from statistics import mean

FOLDER = Path(__file__).resolve().parent
RESAMPLES = 10_000
LEARNERS = ("DA-PPO, code scale 4", "PPO-Unaware")

Rewards = dict[int, dict[str, float]]
"""Mean of the column by seed and damage class."""


def main() -> None:
    """Print the comparison."""
    parser = argparse.ArgumentParser(description="Compare two learners of a results page.")
    parser.add_argument("--column", default="forward_reward")
    parser.add_argument("--learners", nargs=2, default=LEARNERS)
    parser.add_argument("name")
    parser.add_argument("seeds", nargs="*")
    asked = parser.parse_args()
    with (FOLDER / asked.name / "per_class.csv").open(encoding="utf-8", newline="") as file:
        rows = [row for row in csv.DictReader(file) if not asked.seeds or row["seed"] in asked.seeds]
    groups = {row["name"]: row["group"] for row in rows}
    one, other = (rewards(rows, learner, asked.column) for learner in asked.learners)
    digits = 3 if asked.column.startswith("tracking") else 1
    for learner, found in zip(asked.learners, (one, other), strict=True):
        means = {seed: mean(classes.values()) for seed, classes in found.items()}
        each = ", ".join(f"seed {seed}: {value:.{digits}f}" for seed, value in means.items())
        print(f"{learner}: {mean(means.values()):.{digits}f} ({each})")
    ahead = sum(over_seeds(one, [name]) > over_seeds(other, [name]) for name in groups)
    print(
        f"{asked.learners[0]} ahead in {ahead} of {len(groups)} classes ({100 * ahead / len(groups):.1f} %)"
    )
    for subset, ending in (("all classes", ""), ("adjacent pairs", " A"), ("opposite pairs", " O")):
        chosen = [name for name, group in groups.items() if group.endswith(ending)]
        if chosen:
            print(f"gain, {subset} ({len(chosen)}): {gain(one, other, chosen)}")
    places = digits - 1
    for group in dict.fromkeys(groups.values()):
        members = [name for name in groups if groups[name] == group]
        columns = (
            ", ".join(f"{mean(classes[name] for name in members):.{places}f}" for classes in side.values())
            for side in (one, other)
        )
        print(f"| {group} | {len(members)} | {' | '.join(columns)} |")


def rewards(rows: list[dict[str, str]], learner: str, column: str) -> Rewards:
    """Select one learner's column."""
    found: Rewards = defaultdict(dict)
    for row in rows:
        if row["learner"] == learner:
            found[int(row["seed"])][row["name"]] = float(row[column])
    return found


def over_seeds(side: Rewards, names: list[str]) -> float:
    """Average over all seeds and some classes."""
    return mean(mean(classes[name] for name in names) for classes in side.values())


def gain(one: Rewards, other: Rewards, names: list[str]) -> str:
    """Format the gain of one over the other, with an interval."""
    draw = random.Random(0)
    sides = [list(side.values()) for side in (one, other)]
    ratios = []
    for _ in range(RESAMPLES):
        classes = draw.choices(names, k=len(names))
        means = [
            mean(sum(seed[name] for name in classes) for seed in draw.choices(side, k=len(side)))
            for side in sides
        ]
        ratios.append(means[0] / means[1] - 1)
    ratios.sort()
    low, high = (ratios[round(share * (RESAMPLES - 1))] for share in (0.025, 0.975))
    value = over_seeds(one, names) / over_seeds(other, names) - 1
    return f"{value:+.1%} [{low:+.1%}, {high:+.1%}]"


if __name__ == "__main__":
    main()
