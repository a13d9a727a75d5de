"""Export of a policy or a controller into one folder."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from dappo_batch._checks import folder
from dappo_batch._core import ConfigError
from dappo_batch.commands.invoke import invoke
from dappo_batch.commands.options import Folder, RobotChanged

__all__ = ["export"]


def export(
    run: Folder,
    out: Folder,
    *,
    diagnoser: Folder | None = None,
    expert: Folder | None = None,
    trigger: str | None = None,
    controller: Mapping[str, Any] | None = None,
    robot_changed: RobotChanged | None = None,
) -> Path:
    """Write a policy or a whole controller into one folder, which `Policy.from_export` and `Controller` read.

    Parameters
    ----------
    run
        Run folder of the policy; for a controller it must be damage-aware and evaluated.
    out
        The export folder; an earlier export is replaced.
    diagnoser
        Folder of a diagnoser; by default only the policy is exported.
    expert
        Run folder of the policy that controls the robot during a diagnosis; by default `run` itself.
    trigger
        The trigger, ``"residual"``, ``"speed"`` or ``"observation"``; by default the one of the diagnoser.
    controller
        Other settings of the controller, for example ``{"cooldown": 100}``.
    robot_changed
        What to do if the robot file has changed since the training; see `RobotChanged`.

    Returns
    -------
    Path
        The export folder. Its ``export.json`` describes each file.

    Raises
    ------
    ConfigError
        If a folder or a setting cannot be used, the parts are not of one robot, or `expert`, `trigger` or
        `controller` are given without a diagnoser.
    CheckpointError
        If a file cannot be read, or `out` contains anything but an export.
    """
    target = folder(out, "out")
    for name, value in {"expert": expert, "trigger": trigger, "controller": controller}.items():
        if value is not None and diagnoser is None:
            raise ConfigError(f"{name} cannot be used without diagnoser")
    options = {
        "run": folder(run, "run"),
        "diagnoser": diagnoser,
        "expert": expert,
        "trigger": trigger,
        "controller": controller,
        "robot_changed": robot_changed,
        "out": target,
    }
    invoke("export", options)
    return target
