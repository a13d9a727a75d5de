"""One env step, captured once in a graph and launched T times: policy, physics, reward, ends, resets, record.

A graph fixes which kernels run on which arrays. A step therefore allocates nothing that outlives it, branches
nowhere on the host, and finds everything that changes (weights, class distribution, counters) in arrays.
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
    """Collects rollouts with one call of the host each.

    Parameters
    ----------
    worlds : Worlds
        The worlds; capturing leaves them waiting for their first reset.
    policy : Policy
        The policy that acts in them.
    rollout : Rollout
        Receives what happens.
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
        self.rollout.row.zero_()  # should a device run what it captures, it stays inside of the buffers
        with wp.ScopedCapture() as capture:
            self.step()
        self._graph = capture.graph
        self.worlds.forget_episodes()
        self.rollout.row.zero_()
        self.rollout.step.zero_()

    def step(self) -> None:
        """Do one step, launch by launch: what the graph holds."""
        worlds, policy, rollout = self.worlds, self.policy, self.rollout
        policy.act(worlds.obs, self._noise_keys, rollout.step)
        rollout.record_decision(worlds.obs, policy)
        worlds.step(policy.actions)
        policy.evaluate(worlds.endings.final_obs, worlds.endings.truncated)
        rollout.record_outcome(worlds, policy.values)
        rollout.tick()

    def collect(self, first_step: int) -> Rollout:
        """Fill the rollout: T steps from where the worlds stand.

        Parameters
        ----------
        first_step : int
            Number of the first step in the whole run, so that every (world, step) has noise of its own.

        Returns
        -------
        Rollout
            The buffers, which the next call overwrites.

        Raises
        ------
        PhysicsOverflowError
            If there was no room for all contacts or constraints.
        FloatingPointError
            If the policy produced an action that is not finite.
        """
        self.rollout.row.zero_()
        self.rollout.step.assign(np.array([first_step], dtype=np.uint64))
        for _ in range(self.rollout.horizon):
            wp.capture_launch(self._graph)
        self.policy.evaluate(self.worlds.obs)
        wp.copy(self.rollout.last_values, self.policy.values)
        self.worlds.check_room()
        if count := int(self.worlds.nonfinite_actions.numpy()[0]):
            self.worlds.nonfinite_actions.zero_()
            raise FloatingPointError(f"the policy's actions hold {count} numbers that are not finite")
        return self.rollout
