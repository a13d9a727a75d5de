"""From a robot to what simulates it: one compiled MuJoCo model per damage class."""

from __future__ import annotations

from dappo_batch.model.class_table import (
    ClassTable,
    ClassTableError,
    Physics,
    check_robot,
    compile_class_table,
)

__all__ = ["ClassTable", "ClassTableError", "Physics", "check_robot", "compile_class_table"]
