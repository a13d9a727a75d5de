"""Damage-randomised robots in MuJoCo, and policies that adapt to their damage.

Importing the package registers the Gymnasium ids ``dappo_batch/Ant-v0`` and ``dappo_batch/Hexapod-v0``.
"""

from __future__ import annotations

from dappo_batch import _startup  # first, as it is for the time that the rest takes

# isort: split

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
from dappo_batch._pickling import NotPicklableError
from dappo_batch.class_table import ClassTable, compile_class_table
from dappo_batch.commands import (
    TrainingOptions,
    adapt,
    collect_pairs,
    evaluate,
    evaluate_diagnoser,
    resume,
    train,
    train_diagnoser,
)
from dappo_batch.controller import Controller
from dappo_batch.diagnoser import Diagnoser
from dappo_batch.envs import DamageEnv, DamageVectorEnv, make_vec, register_envs
from dappo_batch.policy import Policy
from dappo_batch.robots import ROBOTS, Robot, load_robot
from dappo_batch.runs import Run, load_run
from dappo_batch.sweeping import sweep

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
    "Diagnoser",
    "NotPicklableError",
    "Policy",
    "Robot",
    "Run",
    "ShapeError",
    "SimulationError",
    "TrainingOptions",
    "__version__",
    "adapt",
    "collect_pairs",
    "compile_class_table",
    "evaluate",
    "evaluate_diagnoser",
    "load_robot",
    "load_run",
    "make_vec",
    "resume",
    "sweep",
    "train",
    "train_diagnoser",
]

__version__ = version("dappo-batch")

register_envs()

_startup.end()
