"""Kinds of input, each a function that generates one from a source of random numbers and tries it."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from . import arguments, commands, files, folders, functions
from .room import Room

Target = Callable[[Random, Room], None]

TARGETS: dict[str, tuple[Target, float]] = {
    "robot_file": (files.robot_file, 5.0),
    "robot": (files.robot, 1.0),
    "configuration": (files.configuration, 3.0),
    "settings": (files.settings, 3.0),
    "damage_spec": (arguments.damage_spec, 20.0),
    "environment": (arguments.environment, 3.0),
    "steps": (arguments.steps, 20.0),
    "table": (arguments.table, 1.0),
    "objects": (arguments.objects, 20.0),
    "functions": (functions.functions, 3.0),
    "sweep": (functions.sweep, 0.5),
    "walk": (arguments.walk, 10.0),
    "single_env": (arguments.single_env, 3.0),
    "command_line": (commands.command_line, 10.0),
    "run_folder": (folders.run_folder, 4.0),
    "diagnoser_folder": (folders.diagnoser_folder, 4.0),
    "dataset": (folders.dataset, 3.0),
    "export_folder": (folders.export_folder, 4.0),
    "report": (folders.report, 0.3),
}
"""By name, with a weight: cheap kinds are tried more often."""
