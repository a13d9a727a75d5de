"""The MJCF of a robot with the changes of its TOML, before it is compiled."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dappo_batch._core import ConfigError
from dappo_batch.model.mujoco_library import MUJOCO_ERRORS
from dappo_batch.model.simplify import simplify
from dappo_batch.robots.faults import raise_faults
from dappo_batch.robots.mjcf import mjcf_faults, read_mjcf

if TYPE_CHECKING:
    import mujoco

    from dappo_batch.results import Edit
    from dappo_batch.robots import Robot

__all__ = ["read_robot_spec"]


def read_robot_spec(robot: Robot) -> tuple[mujoco.MjSpec, tuple[Edit, ...]]:
    """Read the MJCF of a robot, and apply ``[simplify]`` and ``[[override]]``.

    Returns
    -------
    spec : mujoco.MjSpec
        The robot that every user of it compiles.
    edits : tuple of Edit
        What the tables changed.

    Raises
    ------
    ConfigError
        If the MJCF cannot be read, or an entry of the tables cannot be applied.
    """
    raise_faults(f"robot {robot.name}: the MJCF {robot.mjcf_path}", mjcf_faults(robot.mjcf_path))
    try:
        spec = read_mjcf(robot.mjcf_path)
        spec.compiler.usethread = False  # the user chooses the number of threads
    except MUJOCO_ERRORS as error:
        raise ConfigError(f"robot {robot.name}: MuJoCo cannot read {robot.mjcf_path}: {error}") from error
    return spec, simplify(spec, robot)
