"""Use one damaged robot through Gymnasium's own interface, as any single-env program does.

Usage: ``python docs/examples/single_env_gymnasium.py``
"""

from __future__ import annotations

import gymnasium

import dappo_batch  # noqa: F401 (the import registers the ids)


def main() -> None:
    """Run one episode with a jammed hip and print its forward reward and how it ended."""
    env = gymnasium.make("dappo_batch/Ant-v0", damage="uniform", reward="gym", observe_damage=False)
    env.action_space.seed(0)
    obs, info = env.reset(seed=0, options={"damage_class": "jammed_joint@0"})
    print(f"observation {obs.shape}, damage class {info['damage_class']}")

    forward_reward, steps = 0.0, 0
    terminated = truncated = False
    while not (terminated or truncated):
        _, _, terminated, truncated, info = env.step(env.action_space.sample())
        forward_reward += info["forward_velocity"]  # m/s, summed over steps
        steps += 1
    ending = "fell" if terminated else "reached the time limit"
    print(f"{ending} after {steps} steps, forward reward {forward_reward:.1f}")
    env.close()


if __name__ == "__main__":
    main()
