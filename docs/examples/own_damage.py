"""Train a policy for a damage type that is not part of the package.

Usage: ``python docs/examples/own_damage.py [FOLDER [STEPS]]``
"""

from __future__ import annotations

import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar

import mujoco
import numpy as np

import dappo_batch
from dappo_batch import DamageType, Limb


@dappo_batch.register_damage_type
@dataclass(frozen=True)
class RustyJoints(DamageType):
    """All joints of the limb have more damping."""

    factor: float  # damping at severity 1, as a multiple of the healthy one
    name: ClassVar[str] = "rusty_joints"

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        """Damage one limb; see `DamageType.apply`."""
        for name in limb.joints:
            joint = spec.joint(name)
            joint.damping = (1 + severity * (self.factor - 1)) * np.asarray(joint.damping)


def main(folder: Path, steps: int) -> None:
    """Train with the new type and one of the package, and print the forward reward of each class."""
    settings = {
        "damage": {
            "types": ["missing_toe", "rusty_joints"],
            "options": {"rusty_joints": {"factor": 8.0}},
            "max_damaged_limbs": 1,
        },
        "evaluation.episodes": 2,
    }
    run = dappo_batch.train(folder / "run", robot="ant", num_envs=64, total_steps=steps, set=settings)
    classes = run.per_class["true"]
    for name, reward in zip(classes["name"], classes["forward_reward"], strict=True):
        print(f"{name:<16} {reward:8.1f}")  # m/s, summed over steps


if __name__ == "__main__":
    where = Path(sys.argv[1]) if len(sys.argv) > 1 else Path(tempfile.mkdtemp())
    main(where, int(sys.argv[2]) if len(sys.argv) > 2 else 50_000)
