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
"""Called with the metrics of each iteration or epoch, a line of ``metrics.jsonl``; False stops gracefully."""

RobotChanged: TypeAlias = Literal["use-run", "use-file"]
"""If the robot file has changed since the training: use the copy of the robot in the run folder, or the
current file. By default a change is an error that lists the differences."""


class Simulation(TypedDict, total=False):
    """Options of the simulation.

    Attributes
    ----------
    device : str
        ``auto``, ``cpu``, ``gpu``, ``cuda`` or ``warp-cpu``.
    backend : str
        ``auto``, ``lanes`` or ``mujoco``; on the CPU.
    precision : str
        ``f32`` or ``f64``, of the backend ``lanes``.
    threads : int
        Worker threads; by default the number of cores.
    njmax, nconmax : int
        On a GPU, buffer sizes: constraints of each env, and contacts as an average over the envs; by default
        the most that a limbed robot can need.
    """

    device: Device
    backend: Backend
    precision: Precision
    threads: int
    njmax: int
    nconmax: int


class TrainingOptions(Simulation, total=False):
    """Options of a training, as the flags of ``dappo-batch train``: those of `Simulation`, and these.

    Attributes
    ----------
    robot : str
        Built-in robot or path of a robot TOML.
    config : path-like
        Configuration file; by default the one of the robot.
    num_envs : int
        Number of parallel environments, N; the flag ``--envs``.
    total_steps : int
        Env steps of the whole run; the flag ``--steps``.
    seed : int
        Seed of all random streams.
    learner : str
        ``cpu`` or ``gpu``: where the networks are computed.
    unaware : bool
        Hide the damage code from the policy (PPO-Unaware); sets ``damage.min_class_steps`` to 0.
    history : int
        Env steps that the policy observes, instead of the last one alone.
    lstm : int
        Units of an LSTM with which the policy remembers its observations.
    healthy : bool
        Train only on the healthy robot (the expert).
    damage : str
        Train only on this damage (a specialist), for example ``"missing_toe@1"``.
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
    history: int
    lstm: int
    healthy: bool
    damage: str
    reward: str
    physics: Physics
    set: Mapping[str, Any]


FLAGS: Mapping[str, str] = {"envs": "num_envs", "steps": "total_steps"}
"""Options whose flags have other names. Functions accept these old names with a warning."""


def renamed(options: Mapping[str, Any]) -> dict[str, Any]:
    """Return options with names of flags replaced by their own, with a warning.

    Raises
    ------
    ConfigError
        If an option is given by both names.
    """
    for flag in FLAGS.keys() & options.keys():
        if FLAGS[flag] in options:
            raise ConfigError(f"{FLAGS[flag]} is given twice, also by its old name {flag}")
        # The caller's caller is the user's program.
        warnings.warn(f"the option {flag} is called {FLAGS[flag]} now", FutureWarning, stacklevel=3)
    return {FLAGS.get(name, name): value for name, value in options.items()}
