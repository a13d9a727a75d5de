"""Damage in mid-episode."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Unpack

from dappo_batch.commands.invoke import invoke
from dappo_batch.commands.options import Folder, RobotChanged, Simulation
from dappo_batch.outside_policy import Act
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
    act: Act | str | None = None,
    log: Folder | None = None,
    controller: Mapping[str, Any] | None = None,
    set: Mapping[str, Any] | None = None,
    robot_changed: RobotChanged | None = None,
    **simulation: Unpack[Simulation],
) -> AdaptationReport:
    """Damage robots in mid-episode, and measure how a controller detects, diagnoses and adapts.

    Parameters
    ----------
    run, diagnoser
        Run folder of a damage-aware policy, and folder of a diagnoser.
    damage
        Damage class, by its name or id; by default every class in turn.
    at
        Onset, env steps.
    episodes
        Episodes of each damage class.
    seed
        Seed of the initial states.
    expert
        Run folder of the policy that controls the robot during a diagnosis; by default `run` itself.
    unaware
        Run folder of PPO-Unaware, for comparison.
    act
        A function in the place of PPO-Unaware, or its name, ``"module:function"``: see `evaluate`. It gets
        observations without damage code.
    log
        CSV file for the first episode of a single damage class, step by step.
    controller
        Settings of the controller.
    set
        Settings of the simulated robot that are unknown to the controller.
    robot_changed
        What to do if the robot file has changed since the training; see `RobotChanged`.
    **simulation
        See `Simulation`.

    Returns
    -------
    AdaptationReport
        The trial, its summary and, for a single damage class, the events of each episode.
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
        "act": act,
        "log": log,
        "controller": controller,
        "set": set,
        "robot_changed": robot_changed,
        **simulation,
    }
    (found,) = invoke("adapt", arguments)
    return AdaptationReport.from_dict(found)
