"""The rollout: buffers of T steps in N worlds for a learner, and the step counter on the device.

A captured graph has the same arguments in every launch. It therefore reads the step number from an array,
writes to that row of the buffers, and increments it.
"""

from __future__ import annotations

import warp as wp

from .policy import Policy
from .worlds import Worlds

__all__ = ["Rollout"]

wp.set_module_options({"enable_backward": False})


@wp.kernel
def record_decision(
    # In:
    row_in: wp.array[wp.int32],
    obs_in: wp.array2d[wp.float32],
    action_in: wp.array2d[wp.float32],
    mean_in: wp.array2d[wp.float32],
    log_prob_in: wp.array[wp.float32],
    value_in: wp.array2d[wp.float32],
    # Out:
    obs_out: wp.array3d[wp.float32],
    action_out: wp.array3d[wp.float32],
    mean_out: wp.array3d[wp.float32],
    log_prob_out: wp.array2d[wp.float32],
    value_out: wp.array2d[wp.float32],
) -> None:
    worldid, i = wp.tid()
    row = row_in[0]
    if i < obs_in.shape[1]:
        obs_out[row, worldid, i] = obs_in[worldid, i]
    if i < action_in.shape[1]:
        action_out[row, worldid, i] = action_in[worldid, i]
        mean_out[row, worldid, i] = mean_in[worldid, i]
    if i == 0:
        log_prob_out[row, worldid] = log_prob_in[worldid]
        value_out[row, worldid] = value_in[worldid, 0]


@wp.kernel
def record_outcome(
    # In:
    row_in: wp.array[wp.int32],
    reward_in: wp.array[wp.float32],
    terminated_in: wp.array[wp.bool],
    truncated_in: wp.array[wp.bool],
    diverged_in: wp.array[wp.bool],
    forward_velocity_in: wp.array[wp.float32],
    class_in: wp.array[wp.int32],
    final_value_in: wp.array2d[wp.float32],
    # Out:
    reward_out: wp.array2d[wp.float32],
    terminated_out: wp.array2d[wp.bool],
    truncated_out: wp.array2d[wp.bool],
    diverged_out: wp.array2d[wp.bool],
    forward_velocity_out: wp.array2d[wp.float32],
    class_out: wp.array2d[wp.int32],
    final_value_out: wp.array2d[wp.float32],
) -> None:
    worldid = wp.tid()
    row = row_in[0]
    terminated = terminated_in[worldid]
    truncated = truncated_in[worldid]
    reward_out[row, worldid] = reward_in[worldid]
    terminated_out[row, worldid] = terminated
    truncated_out[row, worldid] = truncated
    diverged_out[row, worldid] = diverged_in[worldid]
    forward_velocity_out[row, worldid] = forward_velocity_in[worldid]
    class_out[row, worldid] = class_in[worldid]
    # The return is bootstrapped at a time limit, but not at a termination.
    final_value_out[row, worldid] = wp.where(truncated and not terminated, final_value_in[worldid, 0], 0.0)


@wp.kernel
def tick(
    # Out:
    row_out: wp.array[wp.int32],
    step_out: wp.array[wp.uint64],
) -> None:
    row_out[0] = row_out[0] + 1
    step_out[0] = step_out[0] + wp.uint64(1)


class Rollout:
    """Buffers of T steps in N worlds.

    Parameters
    ----------
    horizon : int
        Steps T.
    num_worlds, obs_dim, action_dim : int
        Sizes: N, O, A.

    Attributes
    ----------
    row : wp.array of shape [1]
        Row that the next step writes.
    step : wp.array of shape [1]
        Number of the next step in the whole run; the exploration noise depends on it.
    obs : wp.array of shape [T, N, O]
        Raw observations before each step.
    actions, means : wp.array of shape [T, N, A]
        Actions as sampled, and the means of their distributions.
    log_probs, values : wp.array of shape [T, N]
        Log-densities of the actions, values of the observations.
    rewards, forward_velocity : wp.array of shape [T, N]
        Rewards; velocities of the main body along +x, m/s.
    terminated, truncated, diverged : wp.array of shape [T, N]
        Terminations, time limits, and whether the physics diverged.
    damage_class : wp.array of shape [T, N]
        Active damage class of the step.
    final_values : wp.array of shape [T, N]
        Values of the last observations of episodes that were truncated and not terminated, elsewhere 0.
    last_values : wp.array of shape [N, 1]
        Values of the observations after the last step.
    """

    def __init__(self, horizon: int, num_worlds: int, obs_dim: int, action_dim: int) -> None:
        def floats(*shape: int) -> wp.array[wp.float32]:
            return wp.zeros(shape, dtype=wp.float32)

        self.horizon = horizon
        self.row = wp.zeros(1, dtype=wp.int32)
        self.step = wp.zeros(1, dtype=wp.uint64)
        self.obs = floats(horizon, num_worlds, obs_dim)
        self.actions, self.means = (floats(horizon, num_worlds, action_dim) for _ in range(2))
        self.log_probs, self.values = (floats(horizon, num_worlds) for _ in range(2))
        self.rewards, self.forward_velocity = (floats(horizon, num_worlds) for _ in range(2))
        self.terminated, self.truncated, self.diverged = (
            wp.zeros((horizon, num_worlds), dtype=wp.bool) for _ in range(3)
        )
        self.damage_class = wp.zeros((horizon, num_worlds), dtype=wp.int32)
        self.final_values = floats(horizon, num_worlds)
        self.last_values = floats(num_worlds, 1)

    def record_decision(self, obs: wp.array2d[wp.float32], policy: Policy) -> None:
        """Write observations [N, O], actions, log-densities and values."""
        num_worlds, obs_dim = obs.shape
        wp.launch(
            record_decision,
            dim=(num_worlds, max(obs_dim, self.actions.shape[2])),
            inputs=[self.row, obs, policy.actions, policy.means, policy.log_probs, policy.values],
            outputs=[self.obs, self.actions, self.means, self.log_probs, self.values],
        )

    def record_outcome(self, worlds: Worlds, final_values: wp.array2d[wp.float32]) -> None:
        """Write the outcome of the step, and the values [N, 1] of the last observations of episodes."""
        outcome, ends = worlds.outcome, worlds.episode_ends
        wp.launch(
            record_outcome,
            dim=worlds.num_worlds,
            inputs=[
                self.row,
                outcome.reward,
                outcome.terminated,
                ends.truncated,
                outcome.diverged,
                outcome.forward_velocity,
                ends.damage_class,
                final_values,
            ],
            outputs=[
                self.rewards,
                self.terminated,
                self.truncated,
                self.diverged,
                self.forward_velocity,
                self.damage_class,
                self.final_values,
            ],
        )

    def tick(self) -> None:
        """Advance the row and the step counter by one."""
        wp.launch(tick, dim=1, outputs=[self.row, self.step])
