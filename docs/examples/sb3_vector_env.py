"""Train Stable-Baselines3's PPO on damaged Ants, all in one vector env, and print how fast they walk.

Needs Stable-Baselines3 (``pip install 'stable-baselines3>=2.9.2'``).

Usage: ``python docs/examples/sb3_vector_env.py [ENV_STEPS]``
"""

from __future__ import annotations

import sys

from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

import dappo_batch
from dappo_batch.interop.sb3 import Sb3VecEnv

NUM_ENVS = 32
HORIZON = 32


class ForwardVelocity(BaseCallback):
    """Prints the mean forward velocity of every rollout, with and without damage."""

    def _on_rollout_start(self) -> None:
        self.velocities: dict[bool, list[float]] = {False: [], True: []}

    def _on_step(self) -> bool:
        for info in self.locals["infos"]:
            self.velocities[info["damage_class"] > 0].append(info["forward_velocity"])
        return True

    def _on_rollout_end(self) -> None:
        means = {damaged: sum(values) / max(1, len(values)) for damaged, values in self.velocities.items()}
        print(
            f"{self.num_timesteps:>8} steps: healthy {means[False]:6.3f} m/s, damaged {means[True]:6.3f} m/s"
        )


def main() -> None:
    """Train for a few iterations; a policy that walks needs millions of steps."""
    steps = int(sys.argv[1]) if len(sys.argv) > 1 else 2 * NUM_ENVS * HORIZON
    damage = {"healthy": 0.5, "jammed_joint@0": 0.25, "missing_toe@2": 0.25}
    envs = dappo_batch.make_vec("ant", NUM_ENVS, damage=damage, autoreset="same_step", seed=0)
    wrapped = VecNormalize(VecMonitor(Sb3VecEnv(envs)))
    model = PPO("MlpPolicy", wrapped, n_steps=HORIZON, batch_size=256, n_epochs=4, seed=0, device="cpu")
    model.learn(steps, callback=ForwardVelocity())
    wrapped.close()


if __name__ == "__main__":
    main()
