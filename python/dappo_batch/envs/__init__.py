"""Gymnasium environments of damaged robots."""

from __future__ import annotations

from gymnasium.vector import AutoresetMode

from dappo_batch.envs.arguments import Damage, Seed
from dappo_batch.envs.registration import register_envs
from dappo_batch.envs.simulation import Backend, Device, Physics, Precision, RobotLike
from dappo_batch.envs.single_env import DamageEnv
from dappo_batch.envs.vector_env import DamageVectorEnv

__all__ = ["DamageEnv", "DamageVectorEnv", "make_vec", "register_envs"]


def make_vec(
    robot: RobotLike = "ant",
    num_envs: int = 1,
    *,
    damage: Damage = "uniform",
    reward: str | None = None,
    observe_damage: bool = True,
    autoreset: str | AutoresetMode = AutoresetMode.NEXT_STEP,
    seed: Seed = None,
    threads: int | None = None,
    onset: int | tuple[int, int] = (0, 0),
    max_episode_steps: int | None = None,
    severity: float = 1.0,
    max_damaged_limbs: int | None = None,
    physics: Physics | None = None,
    copy: bool = True,
    device: Device = "cpu",
    backend: Backend = "auto",
    precision: Precision = "f32",
    render_mode: str | None = None,
) -> DamageVectorEnv:
    """Make `num_envs` environments of one robot; `DamageVectorEnv` describes every parameter.

    Returns
    -------
    DamageVectorEnv
        Observations float32 [N, O] and actions float32 [N, A]; with `observe_damage` the last
        ``table.space.code_length`` of the O entries are the damage code.

    Raises
    ------
    ConfigError, ShapeError
        If an argument is out of range, has a wrong shape, or names a robot, class or reward that does
        not exist.
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
    return DamageVectorEnv(
        robot,
        num_envs,
        damage=damage,
        reward=reward,
        observe_damage=observe_damage,
        autoreset=autoreset,
        seed=seed,
        threads=threads,
        onset=onset,
        max_episode_steps=max_episode_steps,
        severity=severity,
        max_damaged_limbs=max_damaged_limbs,
        physics=physics,
        copy=copy,
        device=device,
        backend=backend,
        precision=precision,
        render_mode=render_mode,
    )
