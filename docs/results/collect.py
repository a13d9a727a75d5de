"""Collect runs into the tables and the picture of a results page.

Usage: ``python docs/results/collect.py NAME RUN...`` writes ``docs/results/NAME/``, where runs of other
learners and seeds stay:

- ``per_class.csv``: the evaluations of all runs, one row for each run and damage class;
- ``curves.csv``: forward reward over env steps and seconds of training, in equal spans of env steps;
- ``curves.svg``: the curves, a line for the mean over the seeds of a learner and a band from the lowest to
  the highest seed.

It needs nothing but Python.
"""

from __future__ import annotations

import csv
import json
import sys
import tomllib
from collections import defaultdict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import mean
from typing import Any

FOLDER = Path(__file__).resolve().parent
SPANS = 50
"""Points of a curve."""
WIDTH, HEIGHT, MARGIN = 640, 360, 56
COLOURS = ("#0b6e99", "#c2571a", "#4f7d2a", "#7d4f99")


@dataclass(frozen=True)
class Run:
    """One training run: who learned, and what it left behind."""

    learner: str
    seed: int
    points: list[dict[str, float]]
    classes: list[dict[str, str]]


def main() -> None:
    """Write the tables and the picture."""
    name, *folders = sys.argv[1:]
    target = FOLDER / name
    target.mkdir(exist_ok=True)
    found = {(run.learner, run.seed): run for run in [*collected(target), *map(read, map(Path, folders))]}
    runs = [found[key] for key in sorted(found)]
    write(target / "per_class.csv", (tag(run) | row for run in runs for row in run.classes))
    write(target / "curves.csv", (tag(run) | rounded(point) for run in runs for point in run.points))
    (target / "curves.svg").write_text(picture(runs), encoding="utf-8")
    for run in runs:
        reward = mean(float(row["forward_reward"]) for row in run.classes)
        print(f"{run.learner}, seed {run.seed}: {reward:.1f} in {run.points[-1]['seconds']:.0f} s")


def collected(target: Path) -> Iterator[Run]:
    """Read the runs of the tables that are there."""
    tables = [target / "per_class.csv", target / "curves.csv"]
    if not all(table.exists() for table in tables):
        return
    classes, points = (grouped(table) for table in tables)
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
    """Name who learned; the scale of a code that nobody observes is left out."""
    if not config["env"]["observe_damage"]:
        return "PPO-Unaware"
    return f"DA-PPO, code scale {config['ppo'].get('code_scale', 1):g}"


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
    """Name the run in a row of a table."""
    return {"learner": run.learner, "seed": run.seed}


def rounded(point: dict[str, float]) -> dict[str, Any]:
    """Drop digits that mean nothing."""
    digits = {key: round(point[key], 1) for key in ("seconds", "forward_reward")}
    return {"env_steps": int(point["env_steps"])} | digits


def write(path: Path, rows: Iterable[dict[str, Any]]) -> None:
    """Write a table with a header."""
    table = list(rows)
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, table[0].keys(), lineterminator="\n")
        writer.writeheader()
        writer.writerows(table)


def picture(runs: list[Run]) -> str:
    """Draw forward reward over env steps as SVG."""
    learners: dict[str, list[Run]] = defaultdict(list)
    for run in runs:
        learners[run.learner].append(run)
    last = max(point["env_steps"] for run in runs for point in run.points)
    top = max(point["forward_reward"] for run in runs for point in run.points)
    scale = Scale(last, round_up(top))
    shapes = [axes(scale)]
    for line, (colour, (name, group)) in enumerate(zip(COLOURS, learners.items(), strict=False)):
        spans = list(zip(*(run.points for run in group), strict=False))
        values = [[point["forward_reward"] for point in span] for span in spans]
        steps = [span[0]["env_steps"] for span in spans]
        band = [*zip(steps, map(max, values), strict=True)]
        band += reversed([*zip(steps, map(min, values), strict=True)])
        shapes.append(f'<polygon points="{scale.path(band)}" fill="{colour}" opacity="0.2"/>')
        middle = zip(steps, map(mean, values), strict=True)
        shapes.append(
            f'<polyline points="{scale.path(middle)}" fill="none" stroke="{colour}" stroke-width="2"/>'
        )
        label = f"{name}, {len(group)} seed{'s' if len(group) > 1 else ''}"
        shapes.append(f'<text x="{MARGIN + 12}" y="{MARGIN + 18 * line}" fill="{colour}">{label}</text>')
    head = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}"'
    style = 'font-family="sans-serif" font-size="13"><rect width="100%" height="100%" fill="white"/>'
    return "\n".join([f"{head} {style}", *shapes, "</svg>\n"])


@dataclass(frozen=True)
class Scale:
    """From data to pixels."""

    x_max: float
    y_max: float

    def x(self, steps: float) -> float:
        """Return the abscissa of a number of env steps."""
        return MARGIN + steps / self.x_max * (WIDTH - 2 * MARGIN)

    def y(self, reward: float) -> float:
        """Return the ordinate of a forward reward; negative ones lie on the axis."""
        return HEIGHT - MARGIN - max(reward, 0.0) / self.y_max * (HEIGHT - 2 * MARGIN)

    def path(self, points: Iterable[tuple[float, float]]) -> str:
        """Return the points of a line."""
        return " ".join(f"{self.x(steps):.1f},{self.y(reward):.1f}" for steps, reward in points)


def round_up(value: float) -> float:
    """Return the next multiple of 100."""
    return -(-value // 100) * 100


def axes(scale: Scale) -> str:
    """Draw axes with five ticks each."""
    shapes = []
    for tick in range(6):
        steps, reward = tick / 5 * scale.x_max, tick / 5 * scale.y_max
        x, y = scale.x(steps), scale.y(reward)
        shapes += [
            f'<line x1="{MARGIN}" y1="{y:.1f}" x2="{WIDTH - MARGIN}" y2="{y:.1f}" stroke="#ddd"/>',
            f'<text x="{MARGIN - 8}" y="{y + 4:.1f}" text-anchor="end">{reward:.0f}</text>',
            f'<text x="{x:.1f}" y="{HEIGHT - MARGIN + 18}" text-anchor="middle">{steps / 1e6:.1f} M</text>',
        ]
    shapes.append(f'<text x="{WIDTH / 2}" y="{HEIGHT - 12}" text-anchor="middle">env steps</text>')
    shapes.append(f'<text x="{MARGIN - 40}" y="{MARGIN - 20}">forward reward of an episode</text>')
    return "\n".join(shapes)


if __name__ == "__main__":
    main()
