"""Types of the arguments that several commands have."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from os import PathLike
from typing import Any, Literal, TypeAlias, TypedDict

__all__ = ["Callback", "Folder", "RobotChanged", "Simulation", "TrainingOptions"]

Folder: TypeAlias = str | bytes | PathLike[str]
"""A path of the file system; as bytes it need not be UTF-8."""
Callback: TypeAlias = Callable[[dict[str, Any]], bool | None]
"""Told the metrics of each iteration or epoch, a line of ``metrics.jsonl``; ``False`` stops in good order."""

RobotChanged: TypeAlias = Literal["use-run", "use-file"]
"""Where the robot file has changed since a training: go on with the robot as the run has it, or with the file
as it is now. By default that is an error that says what differs."""


class Simulation(TypedDict, total=False):
    """How to simulate.

    Attributes
    ----------
    device : str
        ``auto``, ``cpu``, ``cuda`` or ``warp-cpu``.
    backend : str
        ``auto``, ``lanes`` or ``mujoco``, on the CPU.
    precision : str
        ``f32`` or ``f64``, of the backend ``lanes``.
    threads : int
        Worker threads; all cores if left out.
    """

    device: str
    backend: str
    precision: str
    threads: int


class TrainingOptions(Simulation, total=False):
    """What to train, as the flags of ``dappo-batch train`` of the same names.

    Attributes
    ----------
    robot : str
        Built-in robot or path of a robot TOML.
    config : path-like
        Configuration file instead of the robot's own.
    envs : int
        Number of environments simulated at once, N.
    steps : int
        Env steps of the whole run.
    seed : int
        Seed of all random streams.
    learner : str
        ``cpu`` or ``wgpu``: where the networks are computed.
    unaware : bool
        Hide the damage code from the policy (PPO-Unaware).
    healthy : bool
        Train on the healthy robot alone (the expert).
    reward, physics : str
        Name of a reward function of the robot; ``rk4`` or ``euler``.
    set : mapping
        Any other setting, for example ``{"ppo.gamma": 0.99}`` or ``{"ppo": {"gamma": 0.99}}``.
    """

    robot: str
    config: Folder
    envs: int
    steps: int
    seed: int
    learner: str
    unaware: bool
    healthy: bool
    reward: str
    physics: str
    set: Mapping[str, Any]
