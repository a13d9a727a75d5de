"""Diagnose a log: observations and actions of a few steps, and a simulated healthy twin.

Usage: ``python docs/examples/diagnose_log.py [FOLDER]``. The trainings are far too short to be good.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import dappo_batch

DAMAGE = "missing_toe@1"
STEPS = 10


def log_of_a_walk(policy: dappo_batch.Policy) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Simulate a damaged robot; return its observations, [T + 1, O], and actions, [T, A]."""
    envs = dappo_batch.make_vec("ant", num_envs=1, damage=DAMAGE, seed=3, observe_damage=False)
    seen, _ = envs.reset()
    obs, actions = [seen[0]], []
    for _ in range(STEPS):
        actions.append(policy.act(obs[-1]))
        seen, *_ = envs.step(actions[-1][None])
        obs.append(seen[0])
    envs.close()
    return np.array(obs), np.array(actions)


def main(folder: Path) -> None:
    """Train an expert and a diagnoser, then diagnose a log."""
    expert, pairs, out = folder / "expert", folder / "pairs", folder / "diagnoser"
    quick = {"evaluation.episodes": 1}
    dappo_batch.train(expert, robot="ant", healthy=True, num_envs=64, total_steps=100_000, set=quick)
    dappo_batch.collect_pairs(expert, pairs, rollouts=40, timesteps=STEPS, preset="residual")
    dappo_batch.train_diagnoser(pairs, out, set={"epochs": 5})

    diagnoser = dappo_batch.Diagnoser.load(out, expert=expert)
    obs, actions = log_of_a_walk(dappo_batch.Policy.load(expert))
    probabilities = diagnoser.diagnose(obs, actions)
    for index in np.argsort(-probabilities)[:3]:
        print(f"{probabilities[index]:6.1%}  {diagnoser.class_names[index]}")
    gap = np.abs(obs[1:] - diagnoser.twin(obs, actions)).mean(axis=1)
    print("mean difference to the twin:", " ".join(f"{x:.3f}" for x in gap))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp()))
