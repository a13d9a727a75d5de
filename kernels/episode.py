"""Episodes: step counters, onsets, and ends by termination or time limit.

The semantics are those of ``rust/dappo-sim/src/vector_env`` in autoreset mode ``same_step``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .outcome import Outcome

__all__ = ["NOT_STARTED", "EpisodeEnds", "Episodes", "activate_damage", "count_step", "save_final"]

wp.set_module_options({"enable_backward": False})

NOT_STARTED = 2**64 - 1  # episode number before the first, 0: numbers wrap around


@wp.kernel
def activate_damage_kernel(
    # In:
    step_in: wp.array[wp.int32],
    onset_in: wp.array[wp.int32],
    drawn_class_in: wp.array[wp.int32],
    # Out:
    activated_out: wp.array[wp.bool],
    class_out: wp.array[wp.int32],
) -> None:
    worldid = wp.tid()
    # With onset 0 the damage is active since the reset.
    onset = onset_in[worldid]
    activated = onset > 0 and step_in[worldid] == onset and drawn_class_in[worldid] != 0
    activated_out[worldid] = activated
    if activated:
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
    # As Gymnasium's TimeLimit: a fall in the last step is both terminated and truncated.
    truncated = step >= max_episode_steps_in[0]
    step_out[worldid] = step
    truncated_out[worldid] = truncated
    ended_out[worldid] = truncated or terminated_in[worldid]


@wp.kernel
def save_final_kernel(
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
        Number of completed steps.
    drawn_class : wp.array of shape [N]
        Damage class of the episode, active from the onset on.
    class_steps : wp.array of shape [N]
        Steps of the episodes before this one, back to that which drew the class.
    onset : wp.array of shape [N]
        Step at which the damage strikes.
    damage_class : wp.array of shape [N]
        Active damage class.
    """

    key: wp.array[wp.uint64]
    number: wp.array[wp.uint64]
    step: wp.array[wp.int32]
    drawn_class: wp.array[wp.int32]
    class_steps: wp.array[wp.int32]
    onset: wp.array[wp.int32]
    damage_class: wp.array[wp.int32]

    @classmethod
    def unstarted(cls, keys: NDArray[np.uint64]) -> Episodes:
        """Return the episodes of worlds before their first reset."""
        integers = [wp.zeros(len(keys), dtype=wp.int32) for _ in range(5)]
        number = wp.full(len(keys), wp.uint64(NOT_STARTED), dtype=wp.uint64)
        return cls(wp.array(keys, dtype=wp.uint64), number, *integers)


@dataclass
class EpisodeEnds:
    """The episodes that ended in the last step, and their final values.

    Attributes
    ----------
    max_episode_steps : wp.array of shape [1]
        Steps after which an episode is truncated.
    truncated, ended : wp.array of shape [N]
        Whether the episode reached its time limit; whether it ended, by termination or at the limit.
    damage_class, onset : wp.array of shape [N]
        Damage class that was active in the step, and onset of the episode; set for every world.
    final_obs : wp.array of shape [N, O]
        Last observations of ended episodes; rows of running episodes are stale.
    """

    max_episode_steps: wp.array[wp.int32]
    truncated: wp.array[wp.bool]
    ended: wp.array[wp.bool]
    damage_class: wp.array[wp.int32]
    onset: wp.array[wp.int32]
    final_obs: wp.array2d[wp.float32]

    @classmethod
    def zeros(cls, num_worlds: int, obs_dim: int, max_episode_steps: int) -> EpisodeEnds:
        """Return zeros for `num_worlds` worlds."""
        return cls(
            max_episode_steps=wp.array([max_episode_steps], dtype=wp.int32),
            truncated=wp.zeros(num_worlds, dtype=wp.bool),
            ended=wp.zeros(num_worlds, dtype=wp.bool),
            damage_class=wp.zeros(num_worlds, dtype=wp.int32),
            onset=wp.zeros(num_worlds, dtype=wp.int32),
            final_obs=wp.zeros((num_worlds, obs_dim), dtype=wp.float32),
        )


def activate_damage(episodes: Episodes, activated: wp.array[wp.bool]) -> None:
    """Activate the damage of worlds at their onset, and write to `activated` [N] which worlds these are."""
    wp.launch(
        activate_damage_kernel,
        dim=activated.shape,
        inputs=[episodes.step, episodes.onset, episodes.drawn_class],
        outputs=[activated, episodes.damage_class],
    )


def count_step(episodes: Episodes, outcome: Outcome, ends: EpisodeEnds) -> None:
    """Increment the step counters, and set the truncated and ended episodes from `outcome`."""
    wp.launch(
        count_step_kernel,
        dim=episodes.step.shape,
        inputs=[ends.max_episode_steps, outcome.terminated, episodes.step],
        outputs=[episodes.step, ends.truncated, ends.ended],
    )


def save_final(episodes: Episodes, obs: wp.array2d[wp.float32], ends: EpisodeEnds) -> None:
    """Save the final observations, classes and onsets before a reset overwrites them."""
    wp.launch(
        save_final_kernel,
        dim=obs.shape,
        inputs=[ends.ended, obs, episodes.damage_class, episodes.onset],
        outputs=[ends.final_obs, ends.damage_class, ends.onset],
    )
