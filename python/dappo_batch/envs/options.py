"""The arguments of all environments: names, types, defaults and descriptions."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypedDict

from gymnasium.vector import AutoresetMode

from dappo_batch.envs.arguments import Damage, Seed
from dappo_batch.model import ClassTable, Physics
from dappo_batch.model.variants import Severity
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
"""Name of a built-in robot, path of a robot TOML, a loaded robot, or its compiled class table."""

Device: TypeAlias = Literal["auto", "cpu", "gpu", "cuda", "warp-cpu"]
"""Device of the physics; ``"warp-cpu"`` runs the kernels of ``"cuda"`` on the CPU, slowly."""

Backend: TypeAlias = Literal["auto", "lanes", "mujoco"]
"""Backend on the CPU; ``"auto"`` is the lane engine if it supports the robot."""

Precision: TypeAlias = Literal["f32", "f64"]
"""Floating-point format of the lane engine."""


class EnvOptions(TypedDict, total=False):
    """Arguments of every environment; all are optional.

    Attributes
    ----------
    damage : str, int, sequence, mapping or array
        Distribution of the damage class of an episode: ``"uniform"`` (the default) over all D classes,
        ``"healthy"`` or another class (id or spec string), a sequence of classes, a mapping class → weight,
        or an array of D weights.
    min_class_steps : int
        Steps for which an environment has its damage class at least: episodes that end sooner are followed by
        others of the same class. With 0, the default, each episode draws its class, and a class in which the
        robot soon falls has few of the steps; with `max_episode_steps` all classes have about as many.
    reward : str
        Name of a reward in the robot TOML (``"paper"``, ``"gym"``); by default its ``reward.default``.
    observe_damage : bool
        Append the damage code of the active damage to every observation; true by default.
    history : int
        Env steps whose values of every term are observed, the oldest first, from 1 to 1000; by default as the
        task of the robot has it, which is one step with the built-in ones. Of damage codes only the last one
        is observed.
    seed : int or sequence of int
        Seeds of the random streams, as in `reset`; by default from the operating system's entropy.
    onset : int or (int, int)
        Episode step at which the damage becomes active, or the inclusive range it is drawn from; 0, the
        default, is the reset.
    damage_duration : int or (int, int)
        Steps for which the damage lasts, at least 1, or the inclusive range they are drawn from in every
        episode; by default it lasts for good. Afterwards the robot is healthy.
    damage_pause : int or (int, int)
        Steps from the end of the damage until it returns, at least 1, for as long as before and again and
        again, or the inclusive range they are drawn from in every episode; by default it does not return.
    code_delay : int or (int, int)
        Steps by which the damage code in the observation is late, as after a diagnosis, or the inclusive
        range they are drawn from in every episode; 0 by default. Until then it is that of the healthy robot.
    max_episode_steps : int
        Steps after which an episode is truncated; by default the limit of the robot TOML.
    severity : float or (float, float)
        In (0, 1]; 1, the default, is the full damage. With a range ``(low, high)`` the severity of each
        episode is drawn.
    severity_levels : int
        Number of severities that are compiled for a range, evenly spaced; 4 by default.
    max_damaged_limbs : int
        Maximum number of damaged limbs; by default that of the robot TOML.
    max_damages_per_limb : int
        Maximum number of damages of a limb, of different types; by default that of the robot TOML.
    physics : {"rk4", "euler"}
        Integrator; by default that of the robot's MJCF.
    backend : {"auto", "lanes", "mujoco"}
        Backend on the CPU. ``"lanes"`` computes MuJoCo's equations for several robots at once and is many
        times faster; it supports only limbed robots on a level floor. ``"mujoco"`` is libmujoco and supports
        every robot. ``"auto"``, the default, is ``"lanes"`` if it supports the robot, otherwise ``"mujoco"``.
    precision : {"f32", "f64"}
        Floating-point format of ``"lanes"``: ``"f32"``, the default, is faster, ``"f64"`` equals MuJoCo up to
        rounding. ``"mujoco"`` always computes in double precision.
    render_mode : {"rgb_array"}
        Result of `render`; None by default.
    """

    damage: Damage
    min_class_steps: int
    reward: str | None
    observe_damage: bool
    history: int | None
    seed: Seed
    onset: int | tuple[int, int]
    damage_duration: int | tuple[int, int] | None
    damage_pause: int | tuple[int, int] | None
    code_delay: int | tuple[int, int]
    max_episode_steps: int | None
    severity: Severity
    severity_levels: int
    max_damaged_limbs: int | None
    max_damages_per_limb: int | None
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
        Worker threads; by default the number of cores.
    copy : bool
        If false, every returned array is a view of native memory, valid until the next `step`, `reset` or
        `set_state`, which overwrites it without the GIL: other threads must not read it meanwhile. True by
        default.
    device : {"cpu", "gpu", "cuda", "auto", "warp-cpu"}
        Device of the physics; ``"cpu"`` by default. ``"gpu"`` is the backend ``"gpu"`` on a GPU of any
        maker; it needs a build with that feature and a robot that the lane engine supports. ``"cuda"`` is the
        backend ``"warp"`` on a GPU, in single precision; it needs the extra ``gpu``. ``"auto"`` is ``"cuda"``
        if available; ``"warp-cpu"`` runs the kernels of ``"cuda"`` on the CPU, slowly.
    njmax, nconmax : int
        On a GPU, buffer sizes: constraints of each env, and contacts as an average over the envs; by default
        the most that a limbed robot on a floor can need.
    """

    autoreset: str | AutoresetMode
    threads: int | None
    copy: bool
    device: Device
    njmax: int | None
    nconmax: int | None


_DEFAULTS: VectorEnvOptions = {
    "damage": "uniform",
    "min_class_steps": 0,
    "reward": None,
    "observe_damage": True,
    "history": None,
    "seed": None,
    "onset": (0, 0),
    "damage_duration": None,
    "damage_pause": None,
    "code_delay": (0, 0),
    "max_episode_steps": None,
    "severity": 1.0,
    "severity_levels": 4,
    "max_damaged_limbs": None,
    "max_damages_per_limb": None,
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
    """Return options with defaults for those that are missing; values are checked elsewhere.

    Parameters
    ----------
    owner : str
        Name of the function or class, for the message.
    options : mapping
        The given options.
    known : type
        The type with the allowed options.

    Raises
    ------
    TypeError
        If an option is unknown, as in any other call.
    """
    names = known.__annotations__
    if unknown := [name for name in options if name not in names]:
        raise TypeError(
            f"{owner}() got an unexpected keyword argument {unknown[0]!r};"
            f" expected some of {', '.join(names)}"
        )
    return {**_DEFAULTS, **options}  # type: ignore[typeddict-item]
