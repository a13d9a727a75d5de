"""Compile a robot that is not part of the package: an MJCF and a robot TOML, no code.

Usage: ``python docs/examples/own_robot.py [ROBOT_TOML]``
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

import dappo_batch

TRIPOD = Path(__file__).resolve().parents[2] / "tests" / "python" / "robots" / "tripod.toml"


def main() -> None:
    """Compile all damage classes of the robot and step a few envs of it."""
    path = Path(sys.argv[1]) if len(sys.argv) > 1 else TRIPOD
    table = dappo_batch.compile_class_table(path)
    space = table.space
    print(f"{table.robot.name}: {space.limbs} limbs, damage types {', '.join(space.types)}")
    print(f"{len(space)} damage classes with at most {space.max_damaged_limbs} damaged limbs")
    for item in space.classes[:4]:
        mass = table.models[item.id].body_mass.sum()
        print(f"  {item.id}  {item.name:<16} {mass:.3f} kg")

    # A compiled table is used as it is; a path would be compiled again.
    envs = dappo_batch.make_vec(table, num_envs=8, seed=0)
    obs, _ = envs.reset()
    print(f"observations {obs.shape}, of which {space.code_length} are the damage code")
    rewards = np.zeros(envs.num_envs)
    for _ in range(100):
        _, reward, _, _, _ = envs.step(np.zeros(envs.action_space.shape, dtype=np.float32))
        rewards += reward
    print(f"mean return of 100 steps without action: {rewards.mean():.3f}")
    envs.close()


if __name__ == "__main__":
    main()
