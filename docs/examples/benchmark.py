"""Benchmark learners for a damaged robot: trainings, specialists, other damage than in training, one report.

Usage: ``python docs/examples/benchmark.py [FOLDER [ROBOT [STEPS [SEEDS]]]]``; what was interrupted resumes.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import dappo_batch
from dappo_batch import report
from dappo_batch.model.symmetry import mirror_images

LEARNERS = {
    "da_ppo": {},
    "unaware": {"unaware": True},
    "history": {"unaware": True, "history": 8},
    "recurrent": {"unaware": True, "ppo.lstm": 64},
}
MID_EPISODE = {"damage.onset": {"first": 100, "last": 300}}
OTHER_DAMAGE = {
    "half as severe": {"damage.severity": 0.5},
    "in mid-episode": MID_EPISODE,
    "code 25 steps late": MID_EPISODE | {"damage.code_delay": {"first": 25, "last": 25}},
}


def main(folder: Path, robot: str, steps: int, seeds: int) -> None:
    """Train what is missing, and write ``report.html`` and ``benchmark.csv``."""
    base = {"robot": robot, "total_steps": steps, "evaluation.episodes": 32 if steps > 1_000_000 else 1}
    cells = {
        name: dappo_batch.sweep(base | options, {"seed": range(seeds)}, folder / name)
        for name, options in LEARNERS.items()
    }
    # One specialist for each damage class and its mirror image.
    table = dappo_batch.compile_class_table(robot)
    images = mirror_images(table)
    damages = [item.name for item in table.space.classes if images[item.id] >= item.id]
    dappo_batch.sweep(base | {"seed": 0}, {"damage": damages}, folder / "specialists")

    for damage, settings in OTHER_DAMAGE.items():
        for name, trained in cells.items():
            found = dappo_batch.evaluate(*(cell.path for cell in trained), set=settings).runs
            reached = [run.groups[-1].tracking or run.groups[-1].forward_reward for run in found]
            print(f"damage {damage}, {name}: {', '.join(f'{value:.1f}' for value in reached)}")

    runs = [folder / name for name in (*LEARNERS, "specialists")]
    title = f"Learners for a damaged {robot}"
    page, _ = report.write(runs, folder / "report.html", csv=folder / "benchmark.csv", title=title)
    print(page)


if __name__ == "__main__":
    folder, robot, steps, seeds = (*sys.argv[1:], *("", "ant", "2000", "1")[len(sys.argv) - 1 :])
    main(Path(folder or tempfile.mkdtemp()), robot, int(steps), int(seeds))
