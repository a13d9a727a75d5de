"""A controller that finds out by itself what broke, and lets the robot walk on."""

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
    """Controls robots through damage, each by itself, without a reset.

    Call `act` once a control step with what the robots observe, in a simulation or on a robot. Damage
    classes are never asked for: a robot is taken for healthy until the controller has named its damage.

    Parameters
    ----------
    run
        Run folder of a damage-aware policy that has been evaluated.
    diagnoser
        Folder of ``diagnose train``, best on records of this run with the preset ``residual``.
    expert
        Run folder of the policy that walks while a robot is examined, the one whose records the diagnoser
        learned from; the run itself, as if nothing were damaged, if left out.
    num_robots
        Number of robots, N.
    trigger
        What raises suspicion: ``"residual"``, steps that differ from those of a simulated twin, or
        ``"speed"``, a robot that walks too slowly.
    settings
        Other settings of the controller, for example ``{"cooldown": 100}``.
    threads
        Worker threads. For a few robots, threads that wait for each other cost more time than they save.
    robot_changed
        Where the robot file has changed since the training: ``"use-run"`` goes on with the robot as the run
        has it, ``"use-file"`` with the file as it is now.

    Raises
    ------
    ConfigError
        If a folder or a setting cannot be used, or the parts are not of one robot.
    """

    _instead = "make one from the same folders in the process that uses it"

    def __init__(
        self,
        run: str | bytes | PathLike[str],
        *,
        diagnoser: str | bytes | PathLike[str],
        expert: str | bytes | PathLike[str] | None = None,
        num_robots: int = 1,
        trigger: str = "residual",
        settings: Mapping[str, float] | None = None,
        threads: int = 1,
        robot_changed: RobotChanged | None = None,
    ) -> None:
        self._core = _core.Controller(
            _folder(run, "run"),
            diagnoser=_folder(diagnoser, "diagnoser"),
            expert=None if expert is None else _folder(expert, "expert"),
            num_robots=integer(num_robots, "num_robots", 1, MOST_ROBOTS),
            trigger=text(trigger, "trigger"),
            settings=settings,
            threads=integer(threads, "threads", 1),
            robot_changed=robot_changed,
        )
        self._events: list[Event] = []

    @classmethod
    def from_export(
        cls, folder: str | bytes | PathLike[str], *, num_robots: int = 1, threads: int = 1
    ) -> Controller:
        """Make a controller from the one folder that ``dappo-batch export`` wrote.

        It acts to the bit as the controller that was exported, with the settings it was exported with.

        Parameters
        ----------
        folder
            The export folder.
        num_robots
            Number of robots, N.
        threads
            Worker threads.

        Returns
        -------
        Controller
            The controller; all robots are taken for healthy.

        Raises
        ------
        CheckpointError
            If the folder is no export, a file of it has changed, or it holds a policy alone, without a
            diagnoser; `Policy.from_export` reads that.
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
        """Names of the damage classes; the index is the class."""
        return self._core.class_names

    @property
    def damage_classes(self) -> NDArray[np.int64]:
        """What the policy is told of each robot, [N]."""
        return self._core.damage_classes

    @property
    def events(self) -> list[Event]:
        """All that has happened, in order."""
        return self._events

    def act(self, obs: ArrayLike, forward_velocity: ArrayLike) -> NDArray[np.float32]:
        """Choose the next actions.

        Readings that are not finite are replaced by the last finite ones; a row of NaN stands for a step
        whose readings were lost. Actions are always finite.

        Parameters
        ----------
        obs
            Observations without damage code, [N, O], or [O] of a single robot.
        forward_velocity
            Velocities along +x over the last step, m/s, [N], or a number.

        Returns
        -------
        actions
            In [-1, 1] after clipping, [N, A], or [A] for an observation [O].

        Raises
        ------
        ShapeError
            If a shape does not fit.
        ConfigError
            If an array holds no numbers.
        """
        rows = array(obs, "obs", np.float32)
        velocities = np.atleast_1d(array(forward_velocity, "forward_velocity", np.float64))
        if rows.ndim not in (1, 2) or velocities.ndim != 1:
            raise ShapeError(
                f"obs have shape {rows.shape} and forward_velocity {velocities.shape}, expected"
                f" [{self.num_robots}, {self.obs_dim}] (without damage code) and [{self.num_robots}]"
            )
        single = rows.ndim == 1
        actions = self._core.act(np.atleast_2d(rows), velocities)
        self._events += map(Event.from_dict, self._core.take_events())
        return actions[0] if single else actions

    def reset(self, mask: ArrayLike | None = None) -> None:
        """Begin anew with all robots, or with those of a mask [N].

        They are taken for healthy, and nothing that was read of the robots before is kept.

        Raises
        ------
        ShapeError, ConfigError
            If the mask is not one boolean for each robot.
        """
        self._core.reset(None if mask is None else flags(mask, "mask", self.num_robots).tolist())
