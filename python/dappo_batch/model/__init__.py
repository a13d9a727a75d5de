"""The models of a robot: one compiled MuJoCo model for each damage class."""

from __future__ import annotations

from dappo_batch.model.class_table import (
    ClassTable,
    ClassTableError,
    Physics,
    check_damage_types,
    compile_class_table,
)

__all__ = ["ClassTable", "ClassTableError", "Physics", "check_damage_types", "compile_class_table"]
