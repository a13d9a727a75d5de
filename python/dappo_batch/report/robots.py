"""The compiled robot of a run."""

from __future__ import annotations

from dappo_batch.model import ClassTable, compile_class_table
from dappo_batch.runs import Run
from dappo_batch.runs.robot_of_run import robot_of_run

__all__ = ["class_table"]


def class_table(run: Run) -> ClassTable:
    """Compile the damage classes of a run from its own copy of the robot.

    Raises
    ------
    ConfigError, ClassTableError, CheckpointError
        If the robot cannot be read or compiled.
    """
    damage = run.config.get("damage", {})
    own, _, _ = robot_of_run(run.path, run.robot, damage, "use-run")
    return compile_class_table(
        own or run.robot,
        types=damage.get("types"),
        max_damaged_limbs=damage.get("max_damaged_limbs"),
        max_damages_per_limb=damage.get("max_damages_per_limb"),
        severity=damage.get("severity", 1.0),
        severity_levels=damage.get("severity_levels", 4),
        physics=run.config["env"].get("physics"),
        damage_options=damage.get("options"),
    )
