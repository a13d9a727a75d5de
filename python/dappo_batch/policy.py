"""A trained policy by itself, for programs of one's own."""

from __future__ import annotations

from collections.abc import Sequence
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dappo_batch import _core
from dappo_batch._checks import array, finite, folder, integer, items, text
from dappo_batch._core import ConfigError, ShapeError
from dappo_batch._pickling import NotPicklable
from dappo_batch.commands.options import RobotChanged

__all__ = ["Policy"]


class Policy(NotPicklable):
    """The policy of a run, without exploration noise; `Policy.load` and `Policy.from_export` read it.

    It does what it is told: a `Controller` also finds out what to tell it.
    """

    _instead = "read it from its run folder in the process that uses it"

    def __init__(self, core: _core.Policy) -> None:
        self._core = core

    @classmethod
    def load(
        cls,
        run: str | bytes | PathLike[str],
        *,
        threads: int | None = None,
        robot_changed: RobotChanged | None = None,
    ) -> Policy:
        """Read the policy in the newest checkpoint of a run folder.

        Parameters
        ----------
        run
            The run folder.
        threads
            Worker threads; all cores if left out.
        robot_changed
            Where the robot file has changed since the training: ``"use-run"`` goes on with the robot as the
            run has it, ``"use-file"`` with the file as it is now.

        Raises
        ------
        ConfigError
            If the folder is no run folder, or the robot file has changed and `robot_changed` does not say
            what to do.
        CheckpointError
            If it has no checkpoint that can be read.
        """
        workers = None if threads is None else integer(threads, "threads", 1)
        return cls(_core.Policy.load(folder(run, "run"), threads=workers, robot_changed=robot_changed))

    @classmethod
    def from_export(cls, export: str | bytes | PathLike[str], *, threads: int | None = None) -> Policy:
        """Read the policy of a folder that ``dappo-batch export`` wrote, with a diagnoser or without.

        Parameters
        ----------
        export
            The export folder.
        threads
            Worker threads; all cores if left out.

        Raises
        ------
        CheckpointError
            If the folder is no export, or a file of it has changed.
        """
        workers = None if threads is None else integer(threads, "threads", 1)
        return cls(_core.Policy.from_export(folder(export, "export"), threads=workers))

    @property
    def obs_dim(self) -> int:
        """Length of an observation without damage code, O."""
        return self._core.obs_dim

    @property
    def action_dim(self) -> int:
        """Length of an action, A."""
        return self._core.action_dim

    @property
    def observes_damage(self) -> bool:
        """Whether it can be told a damage class; a policy that was trained with ``--unaware`` cannot."""
        return self._core.observes_damage

    @property
    def class_names(self) -> list[str]:
        """Names of the damage classes; the index is the class."""
        return self._core.class_names

    @property
    def env_steps(self) -> int:
        """Env steps that it was trained for."""
        return self._core.env_steps

    def act(
        self,
        obs: ArrayLike,
        *,
        damage_class: str | int | Sequence[str | int] | NDArray[np.int64] | None = None,
    ) -> NDArray[np.float32]:
        """Choose actions.

        Parameters
        ----------
        obs
            Observations without damage code, [N, O], or [O] of a single robot.
        damage_class
            What the policy is told: a class name or id, or one for each robot, [N]; healthy if left out.

        Returns
        -------
        actions
            Mean actions, [N, A], or [A] for an observation [O]. Clip them to [-1, 1], as the simulation does.

        Raises
        ------
        ConfigError
            If a damage class does not exist, or is told to a policy that observes none, or an observation is
            no finite number.
        ShapeError
            If a shape does not fit.
        """
        rows = array(obs, "obs", np.float32)
        if rows.ndim not in (1, 2):
            raise ShapeError(f"obs have shape {rows.shape}, expected [N, {self.obs_dim}] or [{self.obs_dim}]")
        finite(rows, "obs")
        single = rows.ndim == 1
        rows = np.atleast_2d(rows)
        if damage_class is not None and not self.observes_damage:
            raise ConfigError("the policy observes no damage; leave damage_class out")
        actions = self._core.act(rows, self._classes(damage_class, len(rows)))
        return actions[0] if single else actions

    def _classes(
        self, told: str | int | Sequence[str | int] | NDArray[np.int64] | None, robots: int
    ) -> NDArray[np.int64]:
        if told is None:
            return np.zeros(robots, np.int64)
        each = items(told)
        if each is not None:
            return np.array([self._class(item) for item in each], np.int64)
        return np.full(robots, self._class(told), np.int64)

    def _class(self, told: object) -> int:
        if isinstance(told, str):
            return self._core.parse(text(told, "damage_class"))
        return integer(told, "damage_class", 0)
