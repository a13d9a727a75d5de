"""Everything that a controller or a policy needs, in one folder."""

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
        Run folder of the policy; one for a controller observes the damage and has been evaluated.
    out
        The folder; an earlier export there is replaced.
    diagnoser
        Folder of a diagnoser; the policy alone is exported if left out.
    expert
        Run folder of the policy that walks during a diagnosis; `run` itself if left out.
    trigger
        What raises suspicion, ``"residual"`` (the default) or ``"speed"``.
    controller
        Other settings of the controller, for example ``{"cooldown": 100}``.
    robot_changed
        What to do where the robot file has changed since the training; see `RobotChanged`.

    Returns
    -------
    Path
        The folder. Its ``export.json`` says what each file is.

    Raises
    ------
    ConfigError
        If a folder or a setting cannot be used, the parts are not of one robot, or `expert`, `trigger` or
        `controller` come without a diagnoser.
    CheckpointError
        If a file cannot be read, or `out` holds something else than an export.
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
