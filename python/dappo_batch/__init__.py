"""Damage-randomised robots in MuJoCo, and policies that adapt to their damage.

Importing the package registers the Gymnasium ids ``dappo_batch/Ant-v0``, ``dappo_batch/Go1-v0``,
``dappo_batch/Go2-v0`` and ``dappo_batch/Hexapod-v0``.
"""

from __future__ import annotations

from dappo_batch import _startup  # first, to handle Ctrl-C during the other imports

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
from dappo_batch._extras import MissingExtraError
from dappo_batch._pickling import NotPicklableError
from dappo_batch.commands import (
    TrainingOptions,
    adapt,
    check_robot,
    collect_pairs,
    evaluate,
    evaluate_diagnoser,
    resume,
    train,
    train_diagnoser,
)
from dappo_batch.commands.export import export
from dappo_batch.controller import Controller
from dappo_batch.damage import DamageType, register_damage_type
from dappo_batch.diagnoser import Diagnoser
from dappo_batch.envs import DamageEnv, DamageVectorEnv, EnvOptions, VectorEnvOptions, make_vec, register_envs
from dappo_batch.model import ClassTable, ClassTableError, compile_class_table
from dappo_batch.policy import Policy
from dappo_batch.render import RenderError
from dappo_batch.results import (
    AdaptationReport,
    Change,
    DiagnoserReport,
    EpochMetrics,
    EvaluationReport,
    Event,
    Meta,
    RobotReport,
)
from dappo_batch.robots import ROBOTS, Limb, Robot, load_robot
from dappo_batch.runs import Run, load_run
from dappo_batch.sweeps import sweep

__all__ = [
    "ROBOTS",
    "AdaptationReport",
    "Change",
    "CheckpointError",
    "ClassTable",
    "ClassTableError",
    "ConfigError",
    "Controller",
    "DamageClass",
    "DamageEnv",
    "DamageSpace",
    "DamageType",
    "DamageVectorEnv",
    "DappoError",
    "Diagnoser",
    "DiagnoserReport",
    "EnvOptions",
    "EpochMetrics",
    "EvaluationReport",
    "Event",
    "Limb",
    "Meta",
    "MissingExtraError",
    "NotPicklableError",
    "Policy",
    "RenderError",
    "Robot",
    "RobotReport",
    "Run",
    "ShapeError",
    "SimulationError",
    "TrainingOptions",
    "VectorEnvOptions",
    "__version__",
    "adapt",
    "check_robot",
    "collect_pairs",
    "compile_class_table",
    "evaluate",
    "evaluate_diagnoser",
    "export",
    "load_robot",
    "load_run",
    "make_vec",
    "register_damage_type",
    "resume",
    "sweep",
    "train",
    "train_diagnoser",
]

__version__ = version("dappo-batch")

register_envs()

_startup.end()
