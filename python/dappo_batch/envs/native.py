"""Common base of both kinds of environment: the native simulation, saved states and pictures."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from dappo_batch import _core
from dappo_batch._core import ConfigError, SimulationError
from dappo_batch._pickling import NotPicklable
from dappo_batch.envs.mirror import Mirror, Reflection
from dappo_batch.envs.options import RobotLike, VectorEnvOptions
from dappo_batch.envs.simulation import (
    RGB_ARRAY,
    checked_render_mode,
    class_table,
    native_env,
    painter,
    step_seconds,
)
from dappo_batch.model import ClassTable
from dappo_batch.model.variants import SEVERITY
from dappo_batch.render.live import LivePainter

__all__ = ["NativeEnv", "SavedState"]


@dataclass(frozen=True)
class SavedState(NotPicklable):
    """A state returned by `save_state`: everything on which the next steps of the envs depend."""

    _instead: ClassVar[str] = "use it in the process of its envs"

    core: _core.EnvState = field(repr=False)
    was_reset: bool
    ended: NDArray[np.bool_] = field(repr=False)


class NativeEnv(NotPicklable):
    """Saved states and pictures of N envs in native memory.

    Derived classes call `_start` first.
    """

    metadata: dict[str, Any] = {"render_modes": [RGB_ARRAY]}  # noqa: RUF012 (Gymnasium declares it so)
    table: ClassTable
    closed: bool = False
    _core: _core.VectorEnv
    _painter: LivePainter | None = None
    _severity_column: int | None
    _same_severity: NDArray[np.float64]

    def _start(self, robot: RobotLike, num_envs: int, options: VectorEnvOptions) -> None:
        """Check the arguments, compile the robot and start the simulation."""
        self.render_mode = checked_render_mode(options["render_mode"])
        self.table = class_table(robot, options)
        self._core = native_env(self.table, num_envs, options)
        names = self._core.event_names
        self._severity_column = names.index(SEVERITY) if SEVERITY in names else None
        self._same_severity = np.full(num_envs, self.table.severity if self._severity_column is None else 0.0)
        self._same_severity.flags.writeable = False
        self.metadata = {
            "render_modes": [RGB_ARRAY],
            "render_fps": max(1, round(1.0 / step_seconds(self.table))),
        }
        self._was_reset = False
        self._ended = np.zeros(num_envs, dtype=np.bool_)  # episodes that must be reset
        if self.render_mode is not None:
            self._painter = painter(self.table)

    @property
    def reward_names(self) -> list[str]:
        """Names of the terms of the reward, K of them."""
        return self._core.reward_names

    @property
    def obs_names(self) -> list[str]:
        """What each entry of an observation is, O of them.

        For example ``"joint_pos FR_hip_joint"`` or ``"base_ang_vel z"``; the damage code has names such as
        ``"damage jammed_joint@0"``.
        """
        names = [name for name, _ in self._core.entries]
        space = self.table.space
        code = [f"damage {kind}@{limb}" for limb in range(space.limbs) for kind in space.types]
        return [*names, *code][: self._core.obs.shape[1]]

    @property
    def obs_units(self) -> list[str]:
        """Units of the entries of an observation, before a scale of the task, O of them.

        They are empty for numbers without a unit.
        """
        units = [unit for _, unit in self._core.entries]
        return [*units, *([""] * (self._core.obs.shape[1] - len(units)))]

    @property
    def event_names(self) -> list[str]:
        """Names of what the events of the task draw for an episode, E of them; see ``infos["events"]``."""
        return self._core.event_names

    def mirror(self) -> Mirror:
        """Return how observations and actions are reflected, left to right.

        Raises
        ------
        ConfigError
            If left and right of the robot, or what its task observes or rewards, are not mirror images of
            each other, with the first difference.
        SimulationError
            If the env is closed.
        """
        self._check_open()
        has_code = self._core.obs.shape[1] > len(self._core.entries)
        obs, actions = (
            Reflection(
                np.array([of for of, _ in pairs], np.intp), np.array([sign for _, sign in pairs], np.float32)
            )
            for pairs in self._core.reflections(self.table, has_code)
        )
        return Mirror(obs, actions)

    def _of_task(self) -> dict[str, NDArray[np.float64]]:
        """Return what a task with commands or events adds to the infos."""
        values = {"command": self._core.command, "events": self._core.events}
        return {key: value for key, value in values.items() if value.size}

    def _severity(self) -> NDArray[np.float64]:
        """Return the severity of the damage in the episode of each env, [N]."""
        if self._severity_column is None:
            return self._same_severity
        return self._core.events[:, self._severity_column].copy()

    def save_state(self) -> SavedState:
        """Return the complete state of the envs, for `restore_state`.

        In addition to positions and velocities it contains activations of actuators, delayed signals, the
        warm start of the solver, and the episodes: their steps, damage and random streams. The same actions
        then lead to bit-identical steps.

        Raises
        ------
        SimulationError
            If the env is closed.
        """
        self._check_open()
        return SavedState(self._core.save_state(), self._was_reset, self._ended.copy())

    def _restore(self, state: SavedState) -> None:
        self._check_open()
        if not isinstance(state, SavedState):
            raise ConfigError(f"restore_state takes what save_state returned, got {type(state).__name__}")
        if not state.was_reset:
            raise ConfigError("the state was saved before the first reset and cannot be restored")
        self._core.restore_state(state.core)
        self._was_reset = True
        self._ended = state.ended.copy()

    def _pictures(self) -> tuple[NDArray[np.uint8], ...] | None:
        """Return a picture of every env, or None without a render mode."""
        self._check_open()
        if self._painter is None:
            return None
        qpos, _ = self._core.get_state()
        classes = self._core.damage_class.tolist()
        return tuple(self._painter.draw(*shown) for shown in zip(classes, qpos, strict=True))

    def _free(self) -> None:
        """Free the native memory and end the renderer, also after a failed constructor."""
        if self._painter is not None:
            self._painter.close()
        if hasattr(self, "_core"):
            self._core.close()

    def _check_open(self) -> None:
        if self.closed:
            raise SimulationError("this env is closed; create a new one")
