"""Worlds that the host steps one call at a time: no episodes, no draws, as in Rust's trait ``Backend``."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .task import Task
from .worlds import Worlds

__all__ = ["Step", "Stepper"]


class Step(NamedTuple):
    """The outcome of a step, one entry a world; rows of skipped worlds are undefined."""

    obs: NDArray[np.float32]  # [N, O]
    rewards: NDArray[np.float32]  # [N]
    terminated: NDArray[np.bool_]  # [N]
    forward_velocity: NDArray[np.float32]  # [N]
    diverged: NDArray[np.bool_]  # [N]


class Stepper:
    """N worlds of one robot, with NumPy arrays as arguments and results.

    Parameters
    ----------
    task : Task
        The robot.
    num_worlds : int
        Number of worlds N.
    nconmax, njmax : int, optional
        As for `Worlds`.
    device : str
        Name of the device in Warp, such as ``"cuda:0"``.
    """

    def __init__(
        self,
        task: Task,
        num_worlds: int,
        *,
        nconmax: int | None = None,
        njmax: int | None = None,
        device: str = "cpu",
    ) -> None:
        self.device = device
        with wp.ScopedDevice(device):
            keys = np.zeros(num_worlds, dtype=np.uint64)
            self._worlds = Worlds(task, keys, observe_damage=False, nconmax=nconmax, njmax=njmax)
            self._actions = wp.zeros((num_worlds, self._worlds.action_dim), dtype=wp.float32)
            self._worlds.reset()
            # The first launches compile and load the kernels, which a capture does not allow.
            self._worlds.advance(self._actions)
            with wp.ScopedCapture() as capture:
                self._worlds.advance(self._actions)
            self._graph = capture.graph

    @property
    def row_length(self) -> int:
        """Length of the rows of a snapshot."""
        return self._worlds.row_length

    def reset(
        self,
        worlds: NDArray[np.int64],
        classes: NDArray[np.int64],
        keys: NDArray[np.uint64],
        numbers: NDArray[np.uint64],
    ) -> NDArray[np.float32]:
        """Begin episodes with given numbers in selected worlds.

        Parameters
        ----------
        worlds : array of shape [R]
            Indices of the worlds, each at most once.
        classes, keys, numbers : array of shape [R]
            Damage classes, active from the start; random keys; numbers of the episodes.

        Returns
        -------
        array of shape [N, O]
            Observations; those of the other worlds are unchanged.
        """
        with wp.ScopedDevice(self.device):
            episodes = self._worlds.episodes
            for array, values in (
                (episodes.damage_class, classes),
                (episodes.key, keys),
                (episodes.number, numbers),
            ):
                _replace(array, worlds, values)
            self._worlds.reset_states(wp.array(self._mask(worlds), dtype=wp.bool))
            return self._worlds.obs.numpy()

    def set_classes(self, worlds: NDArray[np.int64], classes: NDArray[np.int64]) -> None:
        """Change the damage classes [C] of some worlds [C]; their states are kept."""
        with wp.ScopedDevice(self.device):
            _replace(self._worlds.episodes.damage_class, worlds, classes)
            self._worlds.apply_classes(self._mask(worlds))

    def step(self, actions: NDArray[np.float32], skip: NDArray[np.bool_]) -> Step:
        """Advance all worlds by one env step, except those of `skip` [N].

        Parameters
        ----------
        actions : array of shape [N, A]
            Clipped to ±1.
        skip : array of shape [N]
            Worlds whose states are kept.

        Raises
        ------
        PhysicsOverflowError
            If a buffer was too small for all contacts or constraints.
        """
        with wp.ScopedDevice(self.device):
            worlds = self._worlds
            saved = worlds.read_state() if skip.any() else None
            self._actions.assign(actions)
            wp.capture_launch(self._graph)
            if saved is not None:
                worlds.write_state(saved, skip)
            outcome = worlds.outcome
            step = Step(
                worlds.obs.numpy(),
                outcome.reward.numpy(),
                outcome.terminated.numpy(),
                outcome.forward_velocity.numpy(),
                outcome.diverged.numpy(),
            )
            worlds.raise_on_overflow()
            return step

    def state(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Return positions [N, nq] (m, rad) and velocities [N, nv] (m/s, rad/s)."""
        with wp.ScopedDevice(self.device):
            data = self._worlds.data
            return data.qpos.numpy().astype(np.float64), data.qvel.numpy().astype(np.float64)

    def set_state(
        self, qpos: NDArray[np.float64], qvel: NDArray[np.float64], skip: NDArray[np.bool_]
    ) -> NDArray[np.float32]:
        """Set worlds, except those of `skip` [N], to states [N, nq] and [N, nv]; return all observations."""
        with wp.ScopedDevice(self.device):
            self._worlds.set_state(qpos, qvel, ~skip)
            return self._worlds.obs.numpy()

    def snapshot(self) -> NDArray[np.float32]:
        """Return the state of the physics, one row a world: [N, row_length]."""
        with wp.ScopedDevice(self.device):
            return self._worlds.read_state()

    def restore(self, rows: NDArray[np.float32], classes: NDArray[np.int64]) -> None:
        """Restore a snapshot [N, row_length] that was taken with the damage classes `classes` [N]."""
        with wp.ScopedDevice(self.device):
            self._worlds.episodes.damage_class.assign(classes.astype(np.int32))
            self._worlds.apply_classes()
            self._worlds.write_state(rows)

    def _mask(self, worlds: NDArray[np.int64]) -> NDArray[np.bool_]:
        mask = np.zeros(self._worlds.num_worlds, dtype=np.bool_)
        mask[worlds] = True
        return mask


def _replace(array: wp.array, worlds: NDArray[np.int64], values: NDArray[np.generic]) -> None:
    """Write new values of some worlds."""
    rows = array.numpy().copy()  # on a CPU it is a view
    rows[worlds] = values
    array.assign(rows)
