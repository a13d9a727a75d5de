"""A trained diagnoser for logged trajectories."""

from __future__ import annotations

from os import PathLike

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dappo_batch import _core
from dappo_batch._checks import array, finite, integer
from dappo_batch._checks import folder as _folder
from dappo_batch._core import ShapeError
from dappo_batch._pickling import NotPicklable
from dappo_batch.commands.options import RobotChanged

__all__ = ["Diagnoser"]


class Diagnoser(NotPicklable):
    """A diagnoser, with a simulation of the healthy twins if it compares robots with them.

    `Diagnoser.load` reads it. It diagnoses recorded trajectories; a `Controller` diagnoses robots online.
    """

    _instead = "load it from its folders in the process that uses it"

    def __init__(self, core: _core.Diagnoser) -> None:
        self._core = core

    @classmethod
    def load(
        cls,
        folder: str | bytes | PathLike[str],
        *,
        expert: str | bytes | PathLike[str],
        threads: int | None = None,
        robot_changed: RobotChanged | None = None,
    ) -> Diagnoser:
        """Load a diagnoser.

        Parameters
        ----------
        folder
            Folder of `train_diagnoser`.
        expert
            Run folder of the policy that collected its training data. Its configuration defines the
            simulation.
        threads
            Worker threads; by default the number of cores.
        robot_changed
            If the robot file has changed since the expert's training: ``"use-run"`` uses the copy of the
            robot in the run folder, ``"use-file"`` the current file.

        Raises
        ------
        ConfigError
            If a folder is of another kind, or the two belong to different robots.
        CheckpointError
            If a file cannot be read.
        """
        workers = None if threads is None else integer(threads, "threads", 1)
        folders = _folder(folder, "folder"), _folder(expert, "expert")
        return cls(_core.Diagnoser.load(*folders, threads=workers, robot_changed=robot_changed))

    @property
    def obs_dim(self) -> int:
        """Length of an observation without damage code, O."""
        return self._core.obs_dim

    @property
    def action_dim(self) -> int:
        """Length of an action, A."""
        return self._core.action_dim

    @property
    def timesteps(self) -> int:
        """Steps of a diagnosis window, T."""
        return self._core.timesteps

    @property
    def class_names(self) -> list[str]:
        """Names of the C damage classes, in the order of their ids."""
        return self._core.class_names

    def diagnose(self, obs: ArrayLike, actions: ArrayLike) -> NDArray[np.float32]:
        """Return the probabilities of the damage classes.

        Parameters
        ----------
        obs
            Observations before the first step and after each step, without damage code, [N, T + 1, O], or
            [T + 1, O] for a single robot.
        actions
            Actions of the steps, [N, T, A], or [T, A].

        Returns
        -------
        probabilities
            [N, C], or [C]; rows sum to 1.

        Raises
        ------
        ShapeError
            If a shape does not fit.
        ConfigError
            If the observations do not determine the robot's state, so that a twin cannot be simulated for a
            diagnoser that needs one, or an array contains anything but finite numbers.
        """
        obs, actions, single = _batches(obs, actions)
        if actions.shape[1] != self.timesteps:
            raise ShapeError(
                f"there are {actions.shape[1]} steps, expected {self.timesteps} as in its training"
            )
        probabilities = self._core.diagnose(obs, actions)
        return probabilities[0] if single else probabilities

    def twin(self, obs: ArrayLike, actions: ArrayLike) -> NDArray[np.float32]:
        """Return the observations of the healthy twins after each step, for any number of steps.

        Parameters
        ----------
        obs, actions
            As for `diagnose`.

        Returns
        -------
        obs
            [N, T, O], or [T, O].

        Raises
        ------
        ShapeError, ConfigError
            As `diagnose`, and for a diagnoser without twins (preset ``observation``).
        """
        obs, actions, single = _batches(obs, actions)
        rows = self._core.twin(obs, actions)
        return rows[0] if single else rows


def _batches(obs: ArrayLike, actions: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.float32], bool]:
    """Return arrays with a batch dimension, and whether it was added."""
    obs, actions = array(obs, "obs", np.float32), array(actions, "actions", np.float32)
    if obs.ndim != actions.ndim or obs.ndim not in (2, 3):
        raise ShapeError(
            f"obs have shape {obs.shape} and actions {actions.shape},"
            " expected [N, T + 1, O] and [N, T, A], or both without N"
        )
    finite(obs, "obs")
    finite(actions, "actions")
    single = obs.ndim == 2
    return (obs[None], actions[None], True) if single else (obs, actions, False)
