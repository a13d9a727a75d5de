"""A trained policy, for your own programs."""

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

    The damage class is an argument of `act`; a `Controller` diagnoses it instead.
    """

    _instead = "load it from its run folder in the process that uses it"

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
        """Load the policy of the newest checkpoint of a run folder.

        Parameters
        ----------
        run
            The run folder.
        threads
            Worker threads; by default the number of cores.
        robot_changed
            If the robot file has changed since the training: ``"use-run"`` uses the copy of the robot in the
            run folder, ``"use-file"`` the current file.

        Raises
        ------
        ConfigError
            If the folder is not a run folder, or the robot file has changed and `robot_changed` is not given.
        CheckpointError
            If it has no readable checkpoint.
        """
        workers = None if threads is None else integer(threads, "threads", 1)
        return cls(_core.Policy.load(folder(run, "run"), threads=workers, robot_changed=robot_changed))

    @classmethod
    def from_export(cls, export: str | bytes | PathLike[str], *, threads: int | None = None) -> Policy:
        """Load the policy of an export folder, with a diagnoser or without.

        Parameters
        ----------
        export
            Folder of `export` or ``dappo-batch export``.
        threads
            Worker threads; by default the number of cores.

        Raises
        ------
        CheckpointError
            If the folder is not an export, or a file has changed.
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
        """Whether the policy observes the damage code; one that was trained with ``--unaware`` does not."""
        return self.code_length > 0

    @property
    def code_length(self) -> int:
        """Length of the damage code, K; 0 for a policy that does not observe it."""
        return self._core.code_length

    @property
    def is_recurrent(self) -> bool:
        """Whether the policy remembers earlier observations, as those do that are trained with ``--lstm``."""
        return self._core.memory > 0

    @property
    def class_names(self) -> list[str]:
        """Names of the damage classes, in the order of their ids."""
        return self._core.class_names

    @property
    def env_steps(self) -> int:
        """Env steps of its training."""
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
            Observations without damage code, [N, O], or with it, [N, O + K], as envs with ``observe_damage``
            return them; [O] or [O + K] for a single robot.
        damage_class
            Class name or id, or one for each robot, [N], whose code the policy receives. By default it is the
            code in `obs`, or that of a healthy robot for observations without code.

        Returns
        -------
        actions
            Mean actions, [N, A], or [A] for a single robot. Clip them to [-1, 1], as the simulation does.

        Raises
        ------
        ConfigError
            If a damage class does not exist, is given to a policy that does not observe damage, an
            observation is not finite, or the policy is recurrent.
        ShapeError
            If a shape does not fit, or `damage_class` is given for observations with damage code.
        """
        if self.is_recurrent:
            raise ConfigError("the policy is recurrent: its actions depend on what it remembers; call `step`")
        rows, classes, single = self._rows(obs, damage_class)
        actions = self._core.act(rows, classes)
        return actions[0] if single else actions

    def initial_state(self, num_robots: int | None = None) -> NDArray[np.float32]:
        """Return what the policy remembers at the start of episodes: states of its LSTM, all zero.

        Parameters
        ----------
        num_robots
            Number of robots, N; None for a single one.

        Returns
        -------
        state
            [N, 2, H], or [2, H] for a single robot; H is 0 for a policy that is not recurrent.
        """
        shape = (2, self._core.memory)
        robots = () if num_robots is None else (integer(num_robots, "num_robots", 1),)
        return np.zeros(robots + shape, np.float32)

    def step(
        self,
        obs: ArrayLike,
        state: ArrayLike,
        *,
        damage_class: str | int | Sequence[str | int] | NDArray[np.int64] | None = None,
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Choose actions from observations and what the policy remembers of those before.

        Parameters
        ----------
        obs, damage_class
            As for `act`.
        state
            What it remembers of each robot, hidden and cell state, [N, 2, H], or [2, H] for a single robot:
            `initial_state` where an episode begins, and else what the last step has returned.

        Returns
        -------
        actions
            As of `act`.
        state
            What it remembers after this step.

        Raises
        ------
        ConfigError
            As `act`.
        ShapeError
            As `act`, and if `state` has another shape.
        """
        rows, classes, single = self._rows(obs, damage_class)
        states = array(state, "state", np.float32)
        finite(states, "state")
        expected = (2, self._core.memory) if single else (len(rows), 2, self._core.memory)
        if states.shape != expected:
            raise ShapeError(f"state has shape {states.shape}, expected {expected}")
        actions, after = self._core.step(rows, states[None] if single else states, classes)
        return (actions[0], after[0]) if single else (actions, after)

    def _rows(
        self, obs: ArrayLike, damage_class: str | int | Sequence[str | int] | NDArray[np.int64] | None
    ) -> tuple[NDArray[np.float32], NDArray[np.int64] | None, bool]:
        """Return rows, the classes whose codes they lack, and whether they are of a single robot."""
        rows = array(obs, "obs", np.float32)
        if rows.ndim not in (1, 2):
            raise ShapeError(f"obs have shape {rows.shape}, expected [N, {self.obs_dim}] or [{self.obs_dim}]")
        finite(rows, "obs")
        single = rows.ndim == 1
        rows = np.atleast_2d(rows)
        if damage_class is not None and not self.observes_damage:
            raise ConfigError("the policy does not observe damage; leave damage_class out")
        is_complete = damage_class is None and rows.shape[1] == self.obs_dim + self.code_length
        return rows, None if is_complete else self._classes(damage_class, len(rows)), single

    def _classes(
        self, damage_class: str | int | Sequence[str | int] | NDArray[np.int64] | None, robots: int
    ) -> NDArray[np.int64]:
        if damage_class is None:
            return np.zeros(robots, np.int64)
        each = items(damage_class)
        if each is not None:
            return np.array([self._class(item) for item in each], np.int64)
        return np.full(robots, self._class(damage_class), np.int64)

    def _class(self, damage_class: object) -> int:
        if isinstance(damage_class, str):
            return self._core.parse(text(damage_class, "damage_class"))
        return integer(damage_class, "damage_class", 0)
