"""The robot of a run: by default the copy of the robot that it was trained on."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dappo_batch._core import ConfigError
from dappo_batch.robots import ROBOTS, load_robot
from dappo_batch.robots.copies import COPY_TOML, RobotCopy, damage_settings, explain

__all__ = ["check_same", "copy_robot", "read_copy", "robot_of_run"]

COPY = "robot"
"""Name of the folder of the copy in a run, a dataset or a diagnoser."""

_WAYS_ON = (
    "`--robot-changed use-run` uses the copy of the robot in the run folder,"
    " `--robot-changed use-file` the current file"
)
# Entries that do not define the robot.
_APART_FROM_THE_ROBOT = ("reward", "pictures", "max_episode_steps")


def copy_robot(robot: str, damage: Mapping[str, Any]) -> RobotCopy:
    """Copy a robot for a new run, and check the copy."""
    copy = RobotCopy.of(robot, damage)
    copy.check()
    return copy


def read_copy(root: Path) -> RobotCopy | None:
    """Read the copy in the folder of a dataset or a diagnoser, if it has one."""
    return RobotCopy.read(root / COPY)


def robot_of_run(
    run: Path, robot: str, damage: Mapping[str, Any], changed: str | None
) -> tuple[Path | None, RobotCopy, bool]:
    """Return the robot for simulations of a run.

    Parameters
    ----------
    run : pathlib.Path
        The run folder.
    robot : str
        The entry ``robot`` of its configuration.
    damage : mapping
        The section ``[damage]`` of its configuration.
    changed : str or None
        ``"use-run"``, ``"use-file"``, or None if a change is an error.

    Returns
    -------
    own : pathlib.Path or None
        The robot TOML of the copy, if that is used; None for `robot`.
    copy : RobotCopy
        The files of that robot.
    is_kept : bool
        Whether the run has a copy, which those of older versions lack.

    Raises
    ------
    ConfigError
        If the robot has changed since the training, and `changed` is None.
    CheckpointError
        If the run's copy cannot be read.
    """
    folder = run / COPY
    if changed == "use-file":
        return None, copy_robot(robot, damage), folder.exists()
    copy = RobotCopy.read(folder)
    if copy is None:
        return None, copy_robot(robot, damage), False
    own = (folder / COPY_TOML).resolve()
    _check_settings(run, copy, damage_settings(load_robot(own), damage))
    if changed is None and (robot in ROBOTS or os.path.isfile(robot)):
        _check_file(run, copy, robot, damage)
    return own, copy, True


def _check_settings(run: Path, copy: RobotCopy, settings: Mapping[str, Any]) -> None:
    if changes := copy.damage_changes(settings):
        raise ConfigError(
            f"{run}: its config.toml changes the meaning of the damage code since the training:\n"
            f"{explain(changes)}\nrestore config.toml, or use `--robot-changed use-file`"
        )


def _check_file(run: Path, copy: RobotCopy, robot: str, damage: Mapping[str, Any]) -> None:
    try:
        differences = copy.differences(RobotCopy.of(robot, damage))
    except ConfigError as error:
        raise ConfigError(
            f"{run}: its robot {robot} has changed since the training, and can no longer be read: {error};"
            " `--robot-changed use-run` uses the copy of the robot in the run folder"
        ) from error
    if differences:
        raise ConfigError(
            f"{run}: its robot {robot} has changed since the training:\n{explain(differences)}\n{_WAYS_ON}"
        )


def check_same(
    one: str, copy: RobotCopy, other: str, other_copy: RobotCopy, *, with_damage: bool = True
) -> None:
    """Check that two folders belong to the same robot.

    Parameters
    ----------
    one, other : str
        The folders, for the message.
    copy, other_copy : RobotCopy
        Their robots.
    with_damage : bool
        Whether the damage codes must have the same meaning.

    Raises
    ------
    ConfigError
        If they do not.
    """
    name, other_name = copy.spec["name"], other_copy.spec["name"]
    if name != other_name:
        raise ConfigError(f"{other} belongs to robot `{other_name}`, expected `{name}`, the robot of {one}")
    ignoring = _APART_FROM_THE_ROBOT if with_damage else (*_APART_FROM_THE_ROBOT, "damage")
    if differences := copy.differences(other_copy, ignoring=ignoring):
        raise ConfigError(
            f"{other} was created with another version of the robot than {one}:\n{explain(differences)}\n"
            "create both with the same version, or use the current robot file: `--robot-changed use-file`"
        )
