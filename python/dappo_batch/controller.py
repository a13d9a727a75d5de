"""A controller that detects and diagnoses damage online, and adapts the policy to it."""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dappo_batch import _core
from dappo_batch._checks import array, flags, integer, text
from dappo_batch._checks import folder as _folder
from dappo_batch._core import ShapeError
from dappo_batch._pickling import NotPicklable
from dappo_batch.commands.options import RobotChanged
from dappo_batch.results import Event

MOST_ROBOTS = 2**24


class Controller(NotPicklable):
    """Controls robots independently, and adapts to damage without a reset.

    Call `act` once in each control step with the observations of the robots, in a simulation or on a robot.
    The true damage class is never an input: the assumed class is ``healthy`` until damage has been diagnosed.

    Parameters
    ----------
    run
        Run folder of a damage-aware policy that has been evaluated.
    diagnoser
        Folder of ``diagnose train``, preferably trained on data of this run with the preset ``residual``, or
        ``observation``.
    expert
        Run folder of the policy that controls the robot during a diagnosis, the one that collected the
        diagnoser's training data; by default `run` itself with the code of the healthy robot.
    num_robots
        Number of robots, N.
    trigger
        What reveals damage: ``"residual"``, the difference between the robot and a simulated twin;
        ``"speed"``, a low forward velocity; or ``"observation"``, diagnoses of the last observations without
        a twin. By default ``"residual"``, or ``"observation"`` with a diagnoser of the preset
        ``observation``.
    settings
        Other settings of the controller, for example ``{"cooldown": 100}``.
    threads
        Worker threads. For a few robots one thread is fastest.
    robot_changed
        If the robot file has changed since the training: ``"use-run"`` uses the copy of the robot in the run
        folder, ``"use-file"`` the current file.

    Raises
    ------
    ConfigError
        If a folder or a setting cannot be used, or the parts are not of one robot.
    """

    _instead = "create one from the same folders in the process that uses it"

    def __init__(
        self,
        run: str | bytes | PathLike[str],
        *,
        diagnoser: str | bytes | PathLike[str],
        expert: str | bytes | PathLike[str] | None = None,
        num_robots: int = 1,
        trigger: str | None = None,
        settings: Mapping[str, float | str] | None = None,
        threads: int = 1,
        robot_changed: RobotChanged | None = None,
    ) -> None:
        self._core = _core.Controller(
            _folder(run, "run"),
            diagnoser=_folder(diagnoser, "diagnoser"),
            expert=None if expert is None else _folder(expert, "expert"),
            num_robots=integer(num_robots, "num_robots", 1, MOST_ROBOTS),
            trigger=None if trigger is None else text(trigger, "trigger"),
            settings=settings,
            threads=integer(threads, "threads", 1),
            robot_changed=robot_changed,
        )
        self._events: list[Event] = []

    @classmethod
    def from_export(
        cls, folder: str | bytes | PathLike[str], *, num_robots: int = 1, threads: int = 1
    ) -> Controller:
        """Create a controller from an export folder.

        Its actions are bit-identical to those of the exported controller with the exported settings.

        Parameters
        ----------
        folder
            Folder of `export` or ``dappo-batch export``.
        num_robots
            Number of robots, N.
        threads
            Worker threads.

        Returns
        -------
        Controller
            The controller; the assumed class of all robots is ``healthy``.

        Raises
        ------
        CheckpointError
            If the folder is not an export, a file has changed, or it contains only a policy, which
            `Policy.from_export` reads.
        """
        controller = cls.__new__(cls)
        controller._core = _core.Controller.from_export(
            _folder(folder, "folder"),
            num_robots=integer(num_robots, "num_robots", 1, MOST_ROBOTS),
            threads=integer(threads, "threads", 1),
        )
        controller._events = []
        return controller

    @property
    def num_robots(self) -> int:
        """Number of robots, N."""
        return self._core.num_robots

    @property
    def obs_dim(self) -> int:
        """Length of an observation without damage code, O."""
        return self._core.obs_dim

    @property
    def action_dim(self) -> int:
        """Length of an action, A."""
        return self._core.action_dim

    @property
    def class_names(self) -> list[str]:
        """Names of the damage classes, in the order of their ids."""
        return self._core.class_names

    @property
    def damage_classes(self) -> NDArray[np.int64]:
        """Assumed damage classes, [N]."""
        return self._core.damage_classes

    @property
    def events(self) -> list[Event]:
        """All events so far, in order."""
        return self._events

    def act(self, obs: ArrayLike, forward_velocity: ArrayLike | None = None) -> NDArray[np.float32]:
        """Choose the next actions.

        Entries that are not finite are replaced by the last finite ones; a row of NaN is a step without an
        observation. Actions are always finite.

        Parameters
        ----------
        obs
            Observations without damage code, [N, O], or [O] for a single robot.
        forward_velocity
            Velocities along +x over the last step, m/s, [N], or a number; not used with the trigger
            ``observation``.

        Returns
        -------
        actions
            In [-1, 1] after clipping, [N, A], or [A] for an observation [O].

        Raises
        ------
        ShapeError
            If a shape does not fit.
        ConfigError
            If an array does not contain numbers, or the forward velocity is needed and missing.
        """
        rows = array(obs, "obs", np.float32)
        velocities = None
        if forward_velocity is not None:
            velocities = np.atleast_1d(array(forward_velocity, "forward_velocity", np.float64))
        if rows.ndim not in (1, 2) or (velocities is not None and velocities.ndim != 1):
            shape = () if velocities is None else velocities.shape
            raise ShapeError(
                f"obs have shape {rows.shape} and forward_velocity {shape}, expected"
                f" [{self.num_robots}, {self.obs_dim}] (without damage code) and [{self.num_robots}]"
            )
        single = rows.ndim == 1
        actions = self._core.act(np.atleast_2d(rows), velocities)
        self._events += map(Event.from_dict, self._core.take_events())
        return actions[0] if single else actions

    def reset(self, mask: ArrayLike | None = None) -> None:
        """Reset all robots, or those of a mask [N].

        Their assumed class becomes ``healthy``, and all earlier observations are discarded.

        Raises
        ------
        ShapeError, ConfigError
            If the mask is not one boolean for each robot.
        """
        self._core.reset(None if mask is None else flags(mask, "mask", self.num_robots).tolist())
