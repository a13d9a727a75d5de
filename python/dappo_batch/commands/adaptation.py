"""Damage in mid-walk."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Unpack

from dappo_batch.commands.invoke import invoke
from dappo_batch.commands.options import Folder, RobotChanged, Simulation
from dappo_batch.results import AdaptationReport

__all__ = ["adapt"]


def adapt(
    run: Folder,
    diagnoser: Folder,
    *,
    damage: str | int | None = None,
    at: int = 300,
    episodes: int = 20,
    seed: int = 0,
    expert: Folder | None = None,
    unaware: Folder | None = None,
    log: Folder | None = None,
    controller: Mapping[str, Any] | None = None,
    set: Mapping[str, Any] | None = None,
    robot_changed: RobotChanged | None = None,
    **simulation: Unpack[Simulation],
) -> AdaptationReport:
    """Let damage strike in mid-walk, and see how a controller finds out and walks on.

    Parameters
    ----------
    run, diagnoser
        Run folder of a damage-aware policy, and folder of a diagnoser.
    damage
        The damage that strikes, by its name or number; every class in turn if left out.
    at
        Step at which it strikes.
    episodes
        Episodes a damage class.
    seed
        Seed of the initial states.
    expert
        Run folder of the policy that walks during a diagnosis; `run` itself if left out.
    unaware
        Run folder of a policy to compare with.
    log
        File for the first episode of a single damage step by step, as CSV.
    controller
        Settings of the controller.
    set
        Settings of the robot that the controller knows nothing of.
    robot_changed
        What to do where the robot file has changed since the training; see `RobotChanged`.
    **simulation
        See `Simulation`.

    Returns
    -------
    AdaptationReport
        The trial, its summary and, for a single damage, the events of each episode.
    """
    arguments = {
        "run": run,
        "diagnoser": diagnoser,
        "damage": str(damage) if isinstance(damage, int) else damage,
        "all_classes": damage is None,
        "at": at,
        "episodes": episodes,
        "seed": seed,
        "expert": expert,
        "unaware": unaware,
        "log": log,
        "controller": controller,
        "set": set,
        "robot_changed": robot_changed,
        **simulation,
    }
    (found,) = invoke("adapt", arguments)
    return AdaptationReport.from_dict(found)
