"""Rollouts for a learner on the host: weights in, buffers out, one call a rollout.

Rust calls this class (``rust/dappo-py/src/warp``) with NumPy arrays.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import warp as wp
from numpy.typing import NDArray

from .captured_step import CapturedStep
from .policy import Policy
from .rollout import Rollout
from .task import Task
from .worlds import Worlds

__all__ = ["Engine", "Snapshot"]


class Snapshot(NamedTuple):
    """The state of an engine between two rollouts."""

    rows: NDArray[np.float32]  # [N, row], see `Worlds.read_state`
    classes: NDArray[np.int32]  # [N], active damage classes
    episodes: NDArray[np.uint64]  # [N, 6]: key, number, step, drawn class, onset, class steps
    obs: NDArray[np.float32]  # [N, O]


class Engine:
    """Worlds, policy and rollout buffers on one device, with all worlds at the start of their first episode.

    Parameters
    ----------
    task : Task
        The robot.
    keys : array of shape [N]
        Random keys of the worlds, and of their exploration noise.
    horizon : int
        Steps of a rollout.
    hidden : sequence of int
        Hidden layers of both nets.
    cumulative : array of shape [D]
        Cumulative probabilities of the damage classes.
    onset : tuple of int
        First and last step of the onset.
    min_class_steps : int
        As for `EpisodeDraws`.
    observe_damage : bool
        Whether the damage code is appended to the observation.
    max_episode_steps : int
        Steps after which an episode is truncated.
    nconmax, njmax : int, optional
        As for `Worlds`.
    device : str
        Name of the device in Warp, such as ``"cuda:0"``.
    """

    def __init__(
        self,
        task: Task,
        keys: NDArray[np.uint64],
        *,
        horizon: int,
        hidden: Sequence[int],
        cumulative: NDArray[np.float64],
        onset: tuple[int, int],
        min_class_steps: int,
        observe_damage: bool,
        max_episode_steps: int,
        nconmax: int | None = None,
        njmax: int | None = None,
        device: str = "cpu",
    ) -> None:
        self.device = device
        with wp.ScopedDevice(device):
            self._worlds = worlds = Worlds(
                task,
                keys,
                observe_damage=observe_damage,
                max_episode_steps=max_episode_steps,
                nconmax=nconmax,
                njmax=njmax,
            )
            sizes = (worlds.obs_dim, worlds.code_length, worlds.action_dim)
            self._policy = Policy(worlds.num_worlds, *sizes, hidden)
            rollout = Rollout(horizon, worlds.num_worlds, worlds.obs_dim, worlds.action_dim)
            self._collector = CapturedStep(worlds, self._policy, rollout, keys)
            worlds.draws.onset_range.assign(np.array(onset, dtype=np.int32))
            worlds.draws.min_class_steps.assign(np.array([min_class_steps], dtype=np.int32))
            self.set_class_distribution(cumulative)
            worlds.reset()

    @property
    def row_length(self) -> int:
        """Length of the rows of a snapshot."""
        return self._worlds.row_length

    @property
    def diverged(self) -> int:
        """Number of divergences of the physics of a world so far."""
        return int(self._worlds.diverged.numpy()[0])

    def set_class_distribution(self, cumulative: NDArray[np.float64]) -> None:
        """Set the cumulative probabilities [D] of the classes, from which the next episodes are drawn."""
        self._worlds.draws.cumulative.assign(cumulative)

    def assign(
        self, actor: NDArray[np.float32], critic: NDArray[np.float32], log_std: NDArray[np.float32]
    ) -> None:
        """Set the weights, in the layout of `Mlp.parameters`, and the log-std [A]."""
        self._policy.assign(actor, critic, log_std)

    def assign_transform(
        self, statistics: tuple[NDArray[np.float32], NDArray[np.float32]] | None, code_scale: float
    ) -> None:
        """Set the statistics of observations; see `Normalizer.assign`."""
        self._policy.normalizer.assign(statistics, code_scale)

    def collect(self, first_step: int) -> dict[str, NDArray[np.generic]]:
        """Run the policy for one horizon and return the buffers, which the next call overwrites.

        Parameters
        ----------
        first_step : int
            Number of the first step in the whole run.

        Returns
        -------
        dict
            ``obs`` [T, N, O], ``actions`` and ``means`` [T, N, A], ``last_values`` [N, 1]; everything else
            [T, N]: ``log_probs``, ``values``, ``rewards``, ``final_values``, ``forward_velocity``,
            ``terminated``, ``truncated``.

        Raises
        ------
        PhysicsOverflowError
            If a buffer was too small for all contacts or constraints.
        FloatingPointError
            If the policy produced an action that is not finite.
        """
        with wp.ScopedDevice(self.device):
            rollout = self._collector.collect(first_step)
            names = (
                *("obs", "actions", "means", "log_probs", "values", "rewards", "final_values"),
                *("last_values", "forward_velocity", "terminated", "truncated"),
            )
            return {name: getattr(rollout, name).numpy() for name in names}

    def snapshot(self) -> Snapshot:
        """Return the state between two rollouts."""
        with wp.ScopedDevice(self.device):
            fields = [field.numpy().astype(np.uint64) for field in self._episode_fields()]
            return Snapshot(
                rows=self._worlds.read_state(),
                classes=self._worlds.episodes.damage_class.numpy(),
                episodes=np.stack(fields, axis=1),
                obs=self._worlds.obs.numpy(),
            )

    def restore(
        self,
        rows: NDArray[np.float32],
        classes: NDArray[np.int32],
        episodes: NDArray[np.uint64],
        obs: NDArray[np.float32],
    ) -> None:
        """Restore the fields of a `Snapshot` of an engine with the same sizes."""
        with wp.ScopedDevice(self.device):
            worlds = self._worlds
            for field, values in zip(self._episode_fields(), episodes.T, strict=True):
                field.assign(values.astype(field.numpy().dtype))
            worlds.episodes.damage_class.assign(classes)
            worlds.apply_classes()
            worlds.write_state(rows)
            worlds.obs.assign(obs)

    def _episode_fields(self) -> tuple[wp.array, ...]:
        of = self._worlds.episodes
        return of.key, of.number, of.step, of.drawn_class, of.onset, of.class_steps
