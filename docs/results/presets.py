"""Draw the presets in one figure: forward reward over minutes of training.

Usage: ``python docs/results/presets.py PRESET=RUN...`` writes ``docs/results/presets/curves.csv``, the mean
forward reward of the episodes that ended within each half minute of rollout and update, and ``curves.svg``.

It needs only Python.
"""

from __future__ import annotations

import json
import sys
import tomllib
from collections import defaultdict
from pathlib import Path
from typing import Any

from collect import write
from curves import MINUTES, picture

TARGET = Path(__file__).resolve().with_suffix("")
SPAN = 30
"""Seconds between the points of a curve."""
END = 600
"""Seconds that are drawn."""


def main() -> None:
    """Write the table and the picture."""
    TARGET.mkdir(exist_ok=True)
    curves: dict[str, list[list[dict[str, float]]]] = defaultdict(list)
    rows: list[dict[str, Any]] = []
    for argument in sys.argv[1:]:
        preset, _, run = argument.partition("=")
        config = tomllib.loads((Path(run) / "config.toml").read_text(encoding="utf-8"))
        points = curve(Path(run) / "metrics.jsonl")
        curves[f"preset {preset}"].append(points)
        rows += [{"preset": preset, "seed": config["seed"]} | point for point in points]
    write(TARGET / "curves.csv", rows)
    (TARGET / "curves.svg").write_text(picture(curves, MINUTES), encoding="utf-8")


def curve(metrics: Path) -> list[dict[str, float]]:
    """Average the episodes that ended within each span of seconds."""
    points: list[dict[str, float]] = []
    seconds = episodes = reward = 0.0
    for line in map(json.loads, metrics.read_text(encoding="utf-8").splitlines()):
        seconds += line["rollout_seconds"] + line["update_seconds"]
        episodes += line["episodes"]
        reward += line["episodes"] * (line["forward_reward"] or 0.0)
        span = (len(points) + 1) * SPAN
        if seconds >= span and span <= END:
            mean = round(reward / episodes, 1)
            points.append({"seconds": span, "env_steps": line["env_steps"], "forward_reward": mean})
            episodes = reward = 0.0
    return points


if __name__ == "__main__":
    main()
