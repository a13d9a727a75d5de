"""The commands of ``dappo-batch`` as functions.

They write the same folders as the command line, but return results instead of printing them, and raise
exceptions. Ctrl-C stops them gracefully and raises ``KeyboardInterrupt``; `resume` continues.
"""

from __future__ import annotations

from dappo_batch.commands.adaptation import adapt
from dappo_batch.commands.check import check_robot
from dappo_batch.commands.diagnosis import collect_pairs, evaluate_diagnoser, train_diagnoser
from dappo_batch.commands.options import Callback, Folder, RobotChanged, Simulation, TrainingOptions
from dappo_batch.commands.training import evaluate, resume, train

__all__ = [
    "Callback",
    "Folder",
    "RobotChanged",
    "Simulation",
    "TrainingOptions",
    "adapt",
    "check_robot",
    "collect_pairs",
    "evaluate",
    "evaluate_diagnoser",
    "resume",
    "train",
    "train_diagnoser",
]
