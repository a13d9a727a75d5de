"""The native simulation that both kinds of environment wrap."""

from __future__ import annotations

from pathlib import Path
from typing import get_args

import numpy as np
from gymnasium.spaces import Box

from dappo_batch import _core
from dappo_batch._checks import boolean, choice, integer, shown, text
from dappo_batch.envs.arguments import (
    MOST_STEPS,
    MOST_THREADS,
    autoreset_mode,
    class_weights,
    fresh_keys,
    optional_step_range,
    step_range,
    stream_keys,
)
from dappo_batch.envs.options import Backend, Device, Precision, RobotLike, VectorEnvOptions
from dappo_batch.model import ClassTable, compile_class_table
from dappo_batch.model.variants import severity_levels
from dappo_batch.render.live import LivePainter
from dappo_batch.robots import Robot

__all__ = [
    "RGB_ARRAY",
    "checked_render_mode",
    "class_table",
    "native_env",
    "painter",
    "spaces",
    "step_seconds",
]

RGB_ARRAY = "rgb_array"
"""The only render mode."""

MOST_HISTORY = 1000  # env steps, as in task files

PICTURE_SIZE = (480, 480)  # height, width in pixels


def checked_render_mode(render_mode: str | None) -> str | None:
    """Return `render_mode` after a check.

    Raises
    ------
    ConfigError
        If there is no such mode.
    """
    # A comparison with an array has no truth value.
    if render_mode is None or (isinstance(render_mode, str) and render_mode == RGB_ARRAY):
        return render_mode
    raise _core.ConfigError(f"render_mode must be None or {RGB_ARRAY!r}, got {shown(render_mode)}")


def painter(table: ClassTable) -> LivePainter:
    """Return the renderer of a class table's robots."""
    return LivePainter(table, *PICTURE_SIZE)


def class_table(robot: RobotLike, options: VectorEnvOptions) -> ClassTable:
    """Return the compiled damage classes of `robot`, or `robot` itself if it is a class table.

    Raises
    ------
    ConfigError
        If options for compiling are given with a compiled table.
    """
    if not isinstance(robot, str | Path | Robot | ClassTable):
        raise _core.ConfigError(
            f"robot must be a name, the path of a robot TOML, a Robot or a ClassTable, got {shown(robot)}"
        )
    severity, levels = options["severity"], options["severity_levels"]
    limit, per_limb = options["max_damaged_limbs"], options["max_damages_per_limb"]
    physics = options["physics"]
    if not isinstance(robot, ClassTable):
        return compile_class_table(
            robot,
            max_damaged_limbs=limit,
            max_damages_per_limb=per_limb,
            severity=severity,
            severity_levels=levels,
            physics=physics,
        )
    chosen, _ = severity_levels(severity, levels)
    given = [option for option in (limit, per_limb, physics) if option is not None]
    if given or chosen not in (1.0, robot.severity):
        raise _core.ConfigError(
            "a compiled class table fixes max_damaged_limbs, max_damages_per_limb, severity and physics; "
            "pass them to compile_class_table"
        )
    return robot


def native_env(table: ClassTable, num_envs: int, options: VectorEnvOptions) -> _core.VectorEnv:
    """Check the arguments and start the simulation of `num_envs` environments.

    Raises
    ------
    ConfigError, ShapeError
        If an argument is out of range or something does not exist.
    """
    keys, seed, reward = fresh_keys(num_envs), options["seed"], options["reward"]
    if seed is not None:
        given_keys, given = stream_keys(seed, num_envs)
        keys = np.where(given, given_keys, keys)
    return _core.VectorEnv(
        table,
        num_envs=num_envs,
        seeds=keys,
        reward=None if reward is None else text(reward, "reward"),
        observe_damage=boolean(options["observe_damage"], "observe_damage"),
        history=_size(options["history"], "history", MOST_HISTORY),
        autoreset=autoreset_mode(options["autoreset"]).name.lower(),
        max_episode_steps=_size(options["max_episode_steps"], "max_episode_steps"),
        class_weights=class_weights(table.space, options["damage"]),
        min_class_steps=integer(options["min_class_steps"], "min_class_steps", 0, MOST_STEPS),
        onset=step_range(options["onset"], "onset"),
        damage_duration=optional_step_range(options["damage_duration"], "damage_duration"),
        damage_pause=optional_step_range(options["damage_pause"], "damage_pause"),
        code_delay=step_range(options["code_delay"], "code_delay"),
        threads=_size(options["threads"], "threads", MOST_THREADS),
        device=choice(options["device"], "device", get_args(Device)),
        backend=choice(options["backend"], "backend", get_args(Backend)),
        precision=choice(options["precision"], "precision", get_args(Precision)),
        njmax=_size(options["njmax"], "njmax"),
        nconmax=_size(options["nconmax"], "nconmax"),
    )


def _size(value: object, name: str, most: int = MOST_STEPS) -> int | None:
    return None if value is None else integer(value, name, 1, most)


def spaces(core: _core.VectorEnv) -> tuple[Box[np.float32], Box[np.float32]]:
    """Return the observation space [O] and the action space [A] of one environment."""
    observation_space: Box[np.float32] = Box(-np.inf, np.inf, (core.obs_dim,), np.float32)
    action_space: Box[np.float32] = Box(-1.0, 1.0, (core.action_dim,), np.float32)
    return observation_space, action_space


def step_seconds(table: ClassTable) -> float:
    """Return the simulated time of one environment step, s."""
    return float(table.models[0].opt.timestep) * int(table.robot.spec["frame_skip"])
