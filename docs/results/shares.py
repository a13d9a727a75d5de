"""Collect specialists, and print which shares of them the learners of a results page reach.

Usage: ``python docs/results/shares.py NAME [RUN...]`` writes what specialists reach with their own damage,
runs of ``dappo-batch train --damage``, into ``docs/results/NAME/specialists.csv``, and prints for each
learner and seed of ``per_class.csv`` there the mean share over damage classes, the mean of the five
lowest, and the lowest. A class without a specialist has that of its mirror image, or else does not count.
It needs the package.
"""

from __future__ import annotations

import argparse
import csv
import tomllib
from collections import defaultdict
from pathlib import Path
from statistics import mean

from collect import write

import dappo_batch
from dappo_batch.model.symmetry import mirror_images

FOLDER = Path(__file__).resolve().parent
WORST = 5


def main() -> None:
    """Write the table of specialists, and print the shares."""
    parser = argparse.ArgumentParser(description="Collect specialists, and print shares of them.")
    parser.add_argument("name")
    parser.add_argument("runs", nargs="*", type=Path)
    asked = parser.parse_args()
    target = FOLDER / asked.name
    if asked.runs:
        write(target / "specialists.csv", map(specialist, asked.runs))
    rows = read(target / "specialists.csv")
    reached = {row["name"]: float(row["forward_reward"]) for row in rows}
    table = dappo_batch.compile_class_table(rows[0]["robot"])
    names = [item.name for item in table.space.classes]
    for name, image in zip(names, mirror_images(table), strict=True):
        if names[image] in reached:
            reached.setdefault(name, reached[names[image]])
    shares: dict[tuple[str, str], dict[str, float]] = defaultdict(dict)
    for row in read(target / "per_class.csv"):
        if row["name"] in reached:
            share = float(row["forward_reward"]) / reached[row["name"]]
            shares[row["learner"], row["seed"]][row["name"]] = share
    print(
        f"mean of the specialists over {len(reached)} of {len(names)} classes: {mean(reached.values()):.1f}"
    )
    for (learner, seed), found in shares.items():
        lowest = sorted(found.values())[:WORST]
        worst = min(found, key=found.__getitem__)
        print(
            f"{learner}, seed {seed}: mean {100 * mean(found.values()):.1f} %, worst {WORST} "
            f"{100 * mean(lowest):.1f} %, lowest {100 * found[worst]:.1f} % ({worst})"
        )


def specialist(run: Path) -> dict[str, str]:
    """Return what a specialist reaches with its own damage."""
    config = tomllib.loads((run / "config.toml").read_text(encoding="utf-8"))
    (mix,) = {stage["mix"] for stage in config["curriculum"]}
    own = {"robot": config["robot"], "seed": str(config["seed"]), "env_steps": str(config["total_steps"])}
    damage = set(mix.split("+"))
    (row,) = (row for row in read(run / "eval" / "per_class.csv") if set(row["name"].split("+")) == damage)
    return own | {
        key: row[key] for key in ("name", "group", "episodes", "forward_reward", "standard_error", "falls")
    }


def read(path: Path) -> list[dict[str, str]]:
    """Read a table."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


if __name__ == "__main__":
    main()
