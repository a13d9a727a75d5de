"""Types of the arguments that several commands have."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from os import PathLike
from typing import Any, Literal, TypeAlias, TypedDict

from dappo_batch._core import ConfigError
from dappo_batch.envs.options import Backend, Device, Precision
from dappo_batch.model import Physics

__all__ = ["FLAGS", "Callback", "Folder", "RobotChanged", "Simulation", "TrainingOptions", "renamed"]

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
    njmax, nconmax : int
        On a GPU, room for the constraints of an env, and for contacts, an env on average; what a limbed robot
        can need at most if left out.
    """

    device: Device
    backend: Backend
    precision: Precision
    threads: int
    njmax: int
    nconmax: int


class TrainingOptions(Simulation, total=False):
    """What to train, as the flags of ``dappo-batch train``: those of `Simulation`, and these.

    Attributes
    ----------
    robot : str
        Built-in robot or path of a robot TOML.
    config : path-like
        Configuration file instead of the robot's own.
    num_envs : int
        Number of environments simulated at once, N; the flag ``--envs``.
    total_steps : int
        Env steps of the whole run; the flag ``--steps``.
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
    num_envs: int
    total_steps: int
    seed: int
    learner: str
    unaware: bool
    healthy: bool
    reward: str
    physics: Physics
    set: Mapping[str, Any]


FLAGS: Mapping[str, str] = {"envs": "num_envs", "steps": "total_steps"}
"""Options whose flags have other names. Functions had them too, and still take them with a warning."""


def renamed(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options under their own names; those of flags are replaced, with a warning.

    Raises
    ------
    ConfigError
        If an option is given by both names.
    """
    for flag in FLAGS.keys() & options.keys():
        if FLAGS[flag] in options:
            raise ConfigError(f"{FLAGS[flag]} is given twice, also by its old name {flag}")
        # Of the caller's caller, which is the program's.
        warnings.warn(f"the option {flag} is called {FLAGS[flag]} now", FutureWarning, stacklevel=3)
    return {FLAGS.get(name, name): value for name, value in options.items()}
