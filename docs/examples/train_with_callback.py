"""Train from Python, monitor with a callback, and stop at a target forward reward.

Usage: ``python docs/examples/train_with_callback.py [FOLDER [STEPS]]``
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

import dappo_batch

GOOD_ENOUGH = 400.0  # forward reward, m/s summed over steps: 20 m in 50 s


def watch(metrics: dict[str, Any]) -> bool:
    """Print progress; `False` stops the training with a checkpoint."""
    forward = metrics["forward_reward"]
    if forward is None:  # no episode has ended in this iteration
        return True
    print(f"{metrics['env_steps']:>9} env steps: forward reward {forward:7.1f}, KL {metrics['kl']:.4f}")
    return forward < GOOD_ENOUGH


def main(folder: Path, steps: int) -> None:
    """Train, read the run as arrays, and resume it."""
    options: dappo_batch.TrainingOptions = {"robot": "ant", "num_envs": 64, "set": {"evaluation.episodes": 2}}
    run = dappo_batch.train(folder / "run", total_steps=steps, callback=watch, **options)
    rewards, seconds = run.metrics["forward_reward"], run.metrics["rollout_seconds"]
    print(f"{len(rewards)} iterations, {seconds.sum():.1f} s of simulation")

    # A run that was stopped resumes from its checkpoint, and is evaluated at the end of its budget.
    finished = dappo_batch.resume(run.path, total_steps=int(run.metrics["env_steps"][-1]))
    classes = finished.per_class["true"]
    best = classes["forward_reward"].argmax()
    print(f"best damage class: {classes['name'][best]}, {classes['forward_reward'][best]:.1f}")


if __name__ == "__main__":
    where = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp())
    main(where, int(sys.argv[2]) if len(sys.argv) > 2 else 100_000)
