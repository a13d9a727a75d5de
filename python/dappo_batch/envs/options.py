"""The arguments of the environments: names, types, defaults and what they mean, for all of them at once."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypedDict

from gymnasium.vector import AutoresetMode

from dappo_batch.envs.arguments import Damage, Seed
from dappo_batch.model import ClassTable, Physics
from dappo_batch.robots import Robot

__all__ = [
    "Backend",
    "Device",
    "EnvOptions",
    "Precision",
    "RobotLike",
    "VectorEnvOptions",
    "completed",
]

RobotLike: TypeAlias = str | Path | Robot | ClassTable
"""A shipped robot's name, the path of a robot TOML, a loaded robot, or its compiled class table."""

Device: TypeAlias = Literal["auto", "cpu", "cuda", "warp-cpu"]
"""Where the physics is computed; ``"warp-cpu"`` runs the kernels of a GPU on the CPU, slowly."""

Backend: TypeAlias = Literal["auto", "lanes", "mujoco"]
"""What simulates on the CPU; ``"auto"`` is the lane engine wherever it knows everything about the robot."""

Precision: TypeAlias = Literal["f32", "f64"]
"""Floating-point format of the lane engine."""


class EnvOptions(TypedDict, total=False):
    """Arguments of every environment; all may be left out.

    Attributes
    ----------
    damage : str, int, sequence, mapping or array
        Where each episode's damage class is drawn from: ``"uniform"`` (the default) over all D classes,
        ``"healthy"`` or another class (id or spec string), a sequence of classes, a mapping class → weight,
        or an array of D weights.
    reward : str
        Name of a reward in the robot TOML (``"paper"``, ``"gym"``); its default if left out.
    observe_damage : bool
        Append the damage code of the class in force to every observation; true by default.
    seed : int or sequence of int
        Random streams to begin with, as in `reset`; from entropy if left out.
    onset : int or (int, int)
        Episode step at which the damage strikes, or the inclusive range it is drawn from; 0, the default, is
        at the reset.
    max_episode_steps : int
        Steps after which an episode is truncated; the robot's own limit if left out.
    severity : float
        In (0, 1]; 1, the default, is the full damage.
    max_damaged_limbs : int
        Most limbs damaged at once; the robot's own number if left out.
    physics : {"rk4", "euler"}
        Integrator; the one in the robot's MJCF if left out.
    backend : {"auto", "lanes", "mujoco"}
        What simulates on the CPU. ``"lanes"`` computes MuJoCo's equations for several robots at once and is
        many times faster; it knows limbed robots on a level floor and refuses all others. ``"mujoco"`` is
        libmujoco and knows every robot. ``"auto"``, the default, takes ``"lanes"`` wherever it can.
    precision : {"f32", "f64"}
        Floating-point format of ``"lanes"``: ``"f32"``, the default, is faster, ``"f64"`` equals MuJoCo up to
        rounding. ``"mujoco"`` always computes in double precision.
    render_mode : {"rgb_array"}
        What `render` returns; nothing if left out.
    """

    damage: Damage
    reward: str | None
    observe_damage: bool
    seed: Seed
    onset: int | tuple[int, int]
    max_episode_steps: int | None
    severity: float
    max_damaged_limbs: int | None
    physics: Physics | None
    backend: Backend
    precision: Precision
    render_mode: str | None


class VectorEnvOptions(EnvOptions, total=False):
    """Arguments of `DamageVectorEnv` and `make_vec`: those of `EnvOptions`, and these.

    Attributes
    ----------
    autoreset : str or AutoresetMode
        ``"next_step"`` (the default), ``"same_step"`` or ``"disabled"``, with Gymnasium's meaning.
    threads : int
        Worker threads; all cores if left out.
    copy : bool
        If false, every returned array is a view of native memory, valid until the next `step`, `reset` or
        `set_state`, which overwrites it while other Python threads run: none may read it meanwhile. True by
        default.
    device : {"cpu", "cuda", "auto", "warp-cpu"}
        Where; ``"cpu"`` by default. ``"cuda"`` is the backend ``"warp"`` on a GPU, in single precision; it
        needs the extra ``gpu``. ``"auto"`` takes it where it can; ``"warp-cpu"`` runs the same kernels on the
        CPU, slowly.
    njmax, nconmax : int
        On a GPU, room for the constraints of an env, and for contacts, an env on average; what a limbed robot
        on a floor can need at most if left out.
    """

    autoreset: str | AutoresetMode
    threads: int | None
    copy: bool
    device: Device
    njmax: int | None
    nconmax: int | None


_DEFAULTS: VectorEnvOptions = {
    "damage": "uniform",
    "reward": None,
    "observe_damage": True,
    "seed": None,
    "onset": (0, 0),
    "max_episode_steps": None,
    "severity": 1.0,
    "max_damaged_limbs": None,
    "physics": None,
    "backend": "auto",
    "precision": "f32",
    "render_mode": None,
    "autoreset": AutoresetMode.NEXT_STEP,
    "threads": None,
    "copy": True,
    "device": "cpu",
    "njmax": None,
    "nconmax": None,
}


def completed(
    owner: str, options: Mapping[str, Any], known: type[EnvOptions] | type[VectorEnvOptions]
) -> VectorEnvOptions:
    """Return options with the defaults of those that were left out; their values are checked elsewhere.

    Parameters
    ----------
    owner : str
        Whose arguments they are, for the message.
    options : mapping
        What was given.
    known : type
        The type that names what may be given.

    Raises
    ------
    TypeError
        If there is no such argument, as from any other call in Python.
    """
    names = known.__annotations__
    if unknown := [name for name in options if name not in names]:
        raise TypeError(
            f"{owner}() got an unexpected keyword argument {unknown[0]!r};"
            f" expected some of {', '.join(names)}"
        )
    return {**_DEFAULTS, **options}  # type: ignore[typeddict-item]
