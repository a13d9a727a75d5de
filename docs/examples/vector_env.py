"""Step 64 damaged Ants with random actions and print the mean forward velocity of every damage class.

Usage: ``python docs/examples/vector_env.py``
"""

from __future__ import annotations

import numpy as np

import dappo_batch

NUM_ENVS = 64
STEPS = 200


def main() -> None:
    """Average the forward velocity over all steps in which a damage class was active."""
    rng = np.random.default_rng(0)
    envs = dappo_batch.make_vec("ant", num_envs=NUM_ENVS, damage="uniform", seed=0)
    classes = envs.table.space.classes
    velocity = np.zeros(len(classes))  # sum over steps, m/s
    steps = np.zeros(len(classes))

    envs.reset()
    ended = np.zeros(NUM_ENVS, dtype=bool)
    for _ in range(STEPS):
        actions = rng.uniform(-1.0, 1.0, envs.action_space.shape).astype(np.float32)
        _, _, terminated, truncated, infos = envs.step(actions)
        # After the end of an episode the next step only resets: nothing moves in it.
        moved = ~ended
        ended = terminated | truncated
        # Several envs share a class, so += on an index array would count only one of them.
        np.add.at(velocity, infos["damage_class"][moved], infos["forward_velocity"][moved])
        np.add.at(steps, infos["damage_class"][moved], 1)
    envs.close()

    print(f"{'class':>5}  {'name':<32}  {'steps':>6}  {'mean v_x, m/s':>13}")
    for item in classes:
        if steps[item.id] > 0:
            mean = velocity[item.id] / steps[item.id]
            print(f"{item.id:>5}  {item.name:<32}  {steps[item.id]:>6.0f}  {mean:>13.3f}")


if __name__ == "__main__":
    main()
