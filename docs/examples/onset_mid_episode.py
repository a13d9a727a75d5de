"""Simulate damage in mid-episode and print how the damage code in the observation changes.

Usage: ``python docs/examples/onset_mid_episode.py``
"""

from __future__ import annotations

import numpy as np

import dappo_batch

DAMAGE = "missing_toe@2"
ONSET = 100  # the damage is active from the 101st step of the episode on
STEPS = 150


def main() -> None:
    """Run two envs, one with damage from the start and one with damage from step `ONSET` on."""
    rng = np.random.default_rng(0)
    envs = dappo_batch.make_vec("hexapod", num_envs=2, damage="healthy", seed=0)
    code_length = envs.table.space.code_length
    names = [item.name for item in envs.table.space.classes]

    # What a reset fixes holds for one episode; onset=(50, 150) in make_vec draws a step for every episode.
    obs, infos = envs.reset(options={"damage_class": DAMAGE, "onset": [0, ONSET]})
    before = infos["damage_class"]
    report("reset", before, obs[:, -code_length:], names)
    for step in range(STEPS):
        actions = rng.uniform(-0.3, 0.3, envs.action_space.shape).astype(np.float32)
        obs, _, _, _, infos = envs.step(actions)
        if (infos["damage_class"] != before).any():
            report(f"step {step}", infos["damage_class"], obs[:, -code_length:], names)
        before = infos["damage_class"]
    envs.close()


def report(when: str, classes: np.ndarray, codes: np.ndarray, names: list[str]) -> None:
    """Print the active damage class and the damage code in the observation, for both envs."""
    for env, (damage_class, code) in enumerate(zip(classes, codes, strict=True)):
        bits = "".join(str(int(bit)) for bit in code)
        print(f"{when:<9} env {env}: {names[damage_class]:<14} code {bits}")


if __name__ == "__main__":
    main()
