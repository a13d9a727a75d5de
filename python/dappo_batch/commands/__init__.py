"""The commands of ``dappo-batch`` as functions.

They do what the command line does and write the same folders, but return results where it prints, and raise
where it ends with an error. Ctrl-C stops them in good order, as there, and raises ``KeyboardInterrupt``;
`resume` goes on.
"""

from __future__ import annotations

from dappo_batch.commands.adaptation import adapt
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
    "collect_pairs",
    "evaluate",
    "evaluate_diagnoser",
    "resume",
    "train",
    "train_diagnoser",
]
