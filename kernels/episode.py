"""Episodes: where every world stands in its own, when its damage strikes, and when it ends.

The semantics are those of ``rust/dappo-sim/src/vector_env`` in same-step mode.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .outcome import Outcome

__all__ = ["BEFORE_THE_FIRST", "Endings", "Episodes", "count_step", "keep_final", "strike"]

wp.set_module_options({"enable_backward": False})

BEFORE_THE_FIRST = 2**64 - 1  # one less than the first episode, 0, as numbers wrap around


@wp.kernel
def strike_kernel(
    # In:
    step_in: wp.array[wp.int32],
    onset_in: wp.array[wp.int32],
    drawn_class_in: wp.array[wp.int32],
    # Out:
    struck_out: wp.array[wp.bool],
    class_out: wp.array[wp.int32],
) -> None:
    worldid = wp.tid()
    # With onset 0 the damage has been there since the reset.
    struck = onset_in[worldid] > 0 and step_in[worldid] == onset_in[worldid] and drawn_class_in[worldid] != 0
    struck_out[worldid] = struck
    if struck:
        class_out[worldid] = drawn_class_in[worldid]


@wp.kernel
def count_step_kernel(
    # In:
    max_episode_steps_in: wp.array[wp.int32],
    terminated_in: wp.array[wp.bool],
    step_in: wp.array[wp.int32],
    # Out:
    step_out: wp.array[wp.int32],
    truncated_out: wp.array[wp.bool],
    ended_out: wp.array[wp.bool],
) -> None:
    worldid = wp.tid()
    step = step_in[worldid] + 1
    # As Gymnasium's TimeLimit: a failure in the last step is both terminated and truncated.
    truncated = step >= max_episode_steps_in[0]
    step_out[worldid] = step
    truncated_out[worldid] = truncated
    ended_out[worldid] = truncated or terminated_in[worldid]


@wp.kernel
def keep_final_kernel(
    # In:
    ended_in: wp.array[wp.bool],
    obs_in: wp.array2d[wp.float32],
    class_in: wp.array[wp.int32],
    onset_in: wp.array[wp.int32],
    # Out:
    obs_out: wp.array2d[wp.float32],
    class_out: wp.array[wp.int32],
    onset_out: wp.array[wp.int32],
) -> None:
    worldid, entry = wp.tid()
    if entry == 0:
        class_out[worldid] = class_in[worldid]
        onset_out[worldid] = onset_in[worldid]
    if ended_in[worldid]:
        obs_out[worldid, entry] = obs_in[worldid, entry]


@dataclass
class Episodes:
    """The running episode of every world.

    Attributes
    ----------
    key : wp.array of shape [N]
        Random key of each world; episode e of a world is a function of (key, e).
    number : wp.array of shape [N]
        Number of the episode.
    step : wp.array of shape [N]
        Steps done.
    drawn_class : wp.array of shape [N]
        Damage class of the episode, in force from the onset on.
    onset : wp.array of shape [N]
        Step at which the damage strikes.
    damage_class : wp.array of shape [N]
        Damage class in force.
    """

    key: wp.array[wp.uint64]
    number: wp.array[wp.uint64]
    step: wp.array[wp.int32]
    drawn_class: wp.array[wp.int32]
    onset: wp.array[wp.int32]
    damage_class: wp.array[wp.int32]

    @classmethod
    def before_the_first(cls, keys: NDArray[np.uint64]) -> Episodes:
        """Return worlds that wait for their first reset."""
        integers = [wp.zeros(len(keys), dtype=wp.int32) for _ in range(4)]
        number = wp.full(len(keys), wp.uint64(BEFORE_THE_FIRST), dtype=wp.uint64)
        return cls(wp.array(keys, dtype=wp.uint64), number, *integers)


@dataclass
class Endings:
    """Which episodes the last step ended, and how they stood then.

    Attributes
    ----------
    max_episode_steps : wp.array of shape [1]
        Steps after which an episode is truncated.
    truncated, ended : wp.array of shape [N]
        Time limits; episodes that ended, be it by failure or at their limit.
    damage_class, onset : wp.array of shape [N]
        Damage class in force during the step and onset of its episode, whether this ended or not.
    final_obs : wp.array of shape [N, O]
        Last observations of ended episodes; rows of others are old.
    """

    max_episode_steps: wp.array[wp.int32]
    truncated: wp.array[wp.bool]
    ended: wp.array[wp.bool]
    damage_class: wp.array[wp.int32]
    onset: wp.array[wp.int32]
    final_obs: wp.array2d[wp.float32]

    @classmethod
    def zeros(cls, num_worlds: int, obs_dim: int, max_episode_steps: int) -> Endings:
        """Return zeros for `num_worlds` worlds."""
        return cls(
            max_episode_steps=wp.array([max_episode_steps], dtype=wp.int32),
            truncated=wp.zeros(num_worlds, dtype=wp.bool),
            ended=wp.zeros(num_worlds, dtype=wp.bool),
            damage_class=wp.zeros(num_worlds, dtype=wp.int32),
            onset=wp.zeros(num_worlds, dtype=wp.int32),
            final_obs=wp.zeros((num_worlds, obs_dim), dtype=wp.float32),
        )


def strike(episodes: Episodes, struck: wp.array[wp.bool]) -> None:
    """Let the damages strike whose step has come, and note in `struck` [N] which."""
    wp.launch(
        strike_kernel,
        dim=struck.shape,
        inputs=[episodes.step, episodes.onset, episodes.drawn_class],
        outputs=[struck, episodes.damage_class],
    )


def count_step(episodes: Episodes, outcome: Outcome, endings: Endings) -> None:
    """Count the step that `outcome` judged, and find the episodes that it ended."""
    wp.launch(
        count_step_kernel,
        dim=episodes.step.shape,
        inputs=[endings.max_episode_steps, outcome.terminated, episodes.step],
        outputs=[episodes.step, endings.truncated, endings.ended],
    )


def keep_final(episodes: Episodes, obs: wp.array2d[wp.float32], endings: Endings) -> None:
    """Save what a reset is about to overwrite."""
    wp.launch(
        keep_final_kernel,
        dim=obs.shape,
        inputs=[endings.ended, obs, episodes.damage_class, episodes.onset],
        outputs=[endings.final_obs, endings.damage_class, endings.onset],
    )
