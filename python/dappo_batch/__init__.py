"""Damage-randomised robots in MuJoCo, and policies that adapt to their damage.

Importing the package registers the Gymnasium ids ``dappo_batch/Ant-v0`` and ``dappo_batch/Hexapod-v0``.
"""

from __future__ import annotations

from importlib.metadata import version

from dappo_batch._core import (
    CheckpointError,
    ConfigError,
    DamageClass,
    DamageSpace,
    DappoError,
    ShapeError,
    SimulationError,
)
from dappo_batch.class_table import ClassTable, compile_class_table
from dappo_batch.controller import Controller
from dappo_batch.envs import DamageEnv, DamageVectorEnv, make_vec, register_envs
from dappo_batch.policy import Policy
from dappo_batch.robots import ROBOTS, Robot, load_robot
from dappo_batch.runs import Run, load_run

__all__ = [
    "ROBOTS",
    "CheckpointError",
    "ClassTable",
    "ConfigError",
    "Controller",
    "DamageClass",
    "DamageEnv",
    "DamageSpace",
    "DamageVectorEnv",
    "DappoError",
    "Policy",
    "Robot",
    "Run",
    "ShapeError",
    "SimulationError",
    "__version__",
    "compile_class_table",
    "load_robot",
    "load_run",
    "make_vec",
]

__version__ = version("dappo-batch")

register_envs()
