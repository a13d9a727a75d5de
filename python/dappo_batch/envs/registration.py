"""The Gymnasium ids: ``dappo_batch/Ant-v0``, ``dappo_batch/Go1-v0``, one for every built-in robot."""

from __future__ import annotations

import gymnasium

from dappo_batch.robots import ROBOTS, load_robot


def env_id(robot: str) -> str:
    """Return the Gymnasium id of a built-in robot."""
    return f"dappo_batch/{robot.title().replace('_', '')}-v0"


def register_envs() -> None:
    """Register all built-in robots with Gymnasium, except ids that are already registered."""
    for name in ROBOTS:
        if env_id(name) in gymnasium.registry:
            continue
        gymnasium.register(
            env_id(name),
            entry_point="dappo_batch.envs.single_env:DamageEnv",
            vector_entry_point="dappo_batch.envs.vector_env:DamageVectorEnv",
            max_episode_steps=int(load_robot(name).spec["max_episode_steps"]),
            kwargs={"robot": name},
        )
