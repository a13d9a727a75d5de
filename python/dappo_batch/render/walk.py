"""An episode to show: its states, its damage, and the events of a controller."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dappo_batch._checks import array, integer, sequence, shown, text
from dappo_batch._core import ConfigError, ShapeError
from dappo_batch.model import ClassTable
from dappo_batch.results import Event

__all__ = ["Walk"]


@dataclass(frozen=True, eq=False)
class Walk:
    """The states of one robot in an episode, with damage and events.

    Attributes
    ----------
    table : ClassTable
        The robot and its damage classes.
    qpos : array_like
        Positions before every step and after the last, [T + 1, nq], as from `DamageVectorEnv.get_state`; [nq]
        for a single state.
    damage : str or int
        Damage class: a damage spec or a class id.
    onset : int
        Step at which the damage becomes active.
    forward_velocity : array_like, optional
        Velocity along +x in every step, m/s, [T].
    events : sequence of Event or mapping, optional
        ``events`` of a `Controller` for this robot, with steps counted from the first state, or those of
        `adapt`.
    known_names : sequence of str, optional
        Names of the damage classes of the controller; by default those of `table`.
    note : str
        Line of the caption about the policy, if there is no controller.

    Raises
    ------
    ConfigError
        If the damage does not exist, the onset is negative, or an argument has a wrong type.
    ShapeError
        If shapes do not fit, or a position is not finite.
    """

    table: ClassTable
    qpos: ArrayLike
    damage: str | int = 0
    onset: int = 0
    forward_velocity: ArrayLike | None = None
    events: Sequence[Event | Mapping[str, Any]] | None = None
    known_names: Sequence[str] | None = None
    note: str = ""

    def __post_init__(self) -> None:
        if not isinstance(self.table, ClassTable):
            raise ConfigError(f"table must be a ClassTable, got {shown(self.table)}")
        self.table.space.parse(self.damage)
        integer(self.onset, "onset", 0)
        text(self.note, "note")
        for name in sequence(() if self.known_names is None else self.known_names, "known_names"):
            text(name, "a known name")
        known = len(self.known_names or self.table.space)
        for event in self.happened or ():
            if event.damage_class is not None and not 0 <= event.damage_class < known:
                raise ConfigError(
                    f"an event has damage class {event.damage_class}, expected one from 0 to {known - 1}"
                )
        states, width = self.states, self.table.models[0].nq
        if states.ndim != 2 or states.shape[1] != width or len(states) == 0:
            raise ShapeError(f"qpos has shape {np.shape(self.qpos)}, expected [T + 1, {width}] or [{width}]")
        if not np.isfinite(states).all():
            raise ShapeError("qpos has entries that are not finite")
        velocities = self.velocities
        if velocities is not None and velocities.shape != (len(states) - 1,):
            raise ShapeError(
                f"forward_velocity has shape {velocities.shape}, expected [{len(states) - 1}]:"
                " one entry fewer than there are states"
            )

    @property
    def states(self) -> NDArray[np.float64]:
        """The positions, [T + 1, nq]."""
        return np.atleast_2d(array(self.qpos, "qpos", np.float64))

    @property
    def velocities(self) -> NDArray[np.float64] | None:
        """The forward velocities, [T]."""
        velocities = self.forward_velocity
        return None if velocities is None else array(velocities, "forward_velocity", np.float64)

    @property
    def happened(self) -> list[Event] | None:
        """The events."""
        if self.events is None:
            return None
        events = sequence(self.events, "events")
        return [event if isinstance(event, Event) else Event.from_dict(event) for event in events]

    @property
    def damage_classes(self) -> NDArray[np.int64]:
        """The active damage in every state, class ids [T + 1]."""
        steps = np.arange(len(self.states))
        return np.where(steps < self.onset, 0, self.table.space.parse(self.damage))

    @property
    def step_seconds(self) -> float:
        """Duration of a step, s."""
        timestep = float(self.table.models[0].opt.timestep)
        return timestep * int(self.table.robot.spec["frame_skip"])


def of_walk(walk: object) -> None:
    """Check that `walk` is a `Walk`.

    Raises
    ------
    ConfigError
        If it is not.
    """
    if not isinstance(walk, Walk):
        raise ConfigError(f"walk must be a Walk, got {shown(walk)}")
