"""One env step, captured once in a graph and launched T times: policy, physics, reward, resets, recording.

A graph fixes which kernels run on which arrays. A step therefore allocates only temporary arrays, has no
branches on the host, and reads everything that changes (weights, class distribution, counters) from arrays.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .policy import Policy
from .rollout import Rollout
from .worlds import Worlds

__all__ = ["CapturedStep"]


class CapturedStep:
    """Collects a rollout in one call of the host.

    Parameters
    ----------
    worlds : Worlds
        The worlds; after the capture they must be reset.
    policy : Policy
        The policy that acts in them.
    rollout : Rollout
        The buffers to fill.
    noise_keys : array of shape [N]
        Random keys of the exploration noise.
    """

    def __init__(
        self, worlds: Worlds, policy: Policy, rollout: Rollout, noise_keys: NDArray[np.uint64]
    ) -> None:
        self.worlds = worlds
        self.policy = policy
        self.rollout = rollout
        self._noise_keys = wp.array(noise_keys, dtype=wp.uint64)
        # The first launches compile and load the kernels, which a capture does not allow.
        self.worlds.reset()
        self.rollout.row.zero_()
        self.step()
        self.rollout.row.zero_()  # in case a device executes while capturing
        with wp.ScopedCapture() as capture:
            self.step()
        self._graph = capture.graph
        self.worlds.restart_numbering()
        self.rollout.row.zero_()
        self.rollout.step.zero_()

    def step(self) -> None:
        """Launch the kernels of one step, the content of the graph."""
        worlds, policy, rollout = self.worlds, self.policy, self.rollout
        policy.act(worlds.obs, self._noise_keys, rollout.step)
        rollout.record_decision(worlds.obs, policy)
        worlds.step(policy.actions)
        policy.evaluate(worlds.episode_ends.final_obs, worlds.episode_ends.truncated)
        rollout.record_outcome(worlds, policy.values)
        rollout.tick()

    def collect(self, first_step: int) -> Rollout:
        """Fill the rollout: T steps from the current states of the worlds.

        Parameters
        ----------
        first_step : int
            Number of the first step in the whole run, so that every (world, step) has different noise.

        Returns
        -------
        Rollout
            The buffers, which the next call overwrites.

        Raises
        ------
        PhysicsOverflowError
            If a buffer was too small for all contacts or constraints.
        FloatingPointError
            If the policy produced an action that is not finite.
        """
        self.rollout.row.zero_()
        self.rollout.step.assign(np.array([first_step], dtype=np.uint64))
        for _ in range(self.rollout.horizon):
            wp.capture_launch(self._graph)
        self.policy.evaluate(self.worlds.obs)
        wp.copy(self.rollout.last_values, self.policy.values)
        self.worlds.raise_on_overflow()
        if count := int(self.worlds.nonfinite_actions.numpy()[0]):
            self.worlds.nonfinite_actions.zero_()
            raise FloatingPointError(f"the policy's actions contain {count} numbers that are not finite")
        return self.rollout
