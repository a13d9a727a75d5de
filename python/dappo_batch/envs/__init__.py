"""Gymnasium environments of damaged robots."""

from __future__ import annotations

from typing import Unpack

from dappo_batch.envs.mirror import Mirror, Reflection
from dappo_batch.envs.options import EnvOptions, RobotLike, VectorEnvOptions
from dappo_batch.envs.registration import register_envs
from dappo_batch.envs.single_env import DamageEnv
from dappo_batch.envs.vector_env import DamageVectorEnv

__all__ = [
    "DamageEnv",
    "DamageVectorEnv",
    "EnvOptions",
    "Mirror",
    "Reflection",
    "VectorEnvOptions",
    "make_vec",
    "register_envs",
]


def make_vec(
    robot: RobotLike = "ant", num_envs: int = 1, **options: Unpack[VectorEnvOptions]
) -> DamageVectorEnv:
    """Create `num_envs` environments of one robot.

    Parameters
    ----------
    robot, num_envs
        As for `DamageVectorEnv`.
    **options
        See `VectorEnvOptions`.

    Returns
    -------
    DamageVectorEnv
        Observations float32 [N, O] and actions float32 [N, A]; with `observe_damage` the last
        ``table.space.code_length`` of the O entries are the damage code.

    Raises
    ------
    ConfigError, ShapeError
        If an argument is out of range, has a wrong shape, or a robot, class or reward does not exist.
    ClassTableError
        If a damage class of the robot does not compile.

    Examples
    --------
    >>> import dappo_batch
    >>> envs = dappo_batch.make_vec("ant", num_envs=4, damage="uniform", seed=0)
    >>> obs, infos = envs.reset()
    >>> obs.shape
    (4, 119)
    """
    return DamageVectorEnv(robot, num_envs, **options)
