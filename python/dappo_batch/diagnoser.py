"""A trained diagnoser by itself: what broke, given what was logged."""

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
    """A diagnoser, and a simulation of the healthy twins that it compares robots with.

    `Diagnoser.load` reads it. It looks at trajectories that are over; a `Controller` looks while the robot
    walks.
    """

    _instead = "read it from its folders in the process that uses it"

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
        """Read a diagnoser.

        Parameters
        ----------
        folder
            Folder of `train_diagnoser`.
        expert
            Run folder of the policy that walked in its training data. Its configuration says how to simulate.
        threads
            Worker threads; all cores if left out.
        robot_changed
            Where the robot file has changed since the expert's training: ``"use-run"`` goes on with the robot
            as the run has it, ``"use-file"`` with the file as it is now.

        Raises
        ------
        ConfigError
            If a folder is not what it should be, or both are not of one robot.
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
        """Steps that it looks at, T."""
        return self._core.timesteps

    @property
    def class_names(self) -> list[str]:
        """Names of the damage classes, C of them; the index is the class."""
        return self._core.class_names

    def diagnose(self, obs: ArrayLike, actions: ArrayLike) -> NDArray[np.float32]:
        """Tell how probable every damage class is.

        Parameters
        ----------
        obs
            Observations before the first step and after each, without damage code, [N, T + 1, O], or
            [T + 1, O] of a single robot.
        actions
            The actions between them, [N, T, A], or [T, A].

        Returns
        -------
        probabilities
            [N, C], or [C]; rows sum to 1.

        Raises
        ------
        ShapeError
            If a shape does not fit.
        ConfigError
            If the observations do not tell a robot's state, so that no twin can be put beside it, or an array
            holds something else than finite numbers.
        """
        obs, actions, single = _batches(obs, actions)
        if actions.shape[1] != self.timesteps:
            raise ShapeError(
                f"there are {actions.shape[1]} steps, expected {self.timesteps} as in its training"
            )
        probabilities = self._core.diagnose(obs, actions)
        return probabilities[0] if single else probabilities

    def twin(self, obs: ArrayLike, actions: ArrayLike) -> NDArray[np.float32]:
        """Tell what the healthy twins observe after each step, for any number of steps.

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
            As `diagnose`.
        """
        obs, actions, single = _batches(obs, actions)
        rows = self._core.twin(obs, actions)
        return rows[0] if single else rows


def _batches(obs: ArrayLike, actions: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.float32], bool]:
    """Return arrays of several robots, and whether they are of a single one."""
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
