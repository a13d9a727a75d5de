"""What a controller and a run tell, as frozen dataclasses; `from_dict` reads them from JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

from dappo_batch._checks import mapping, sequence, shown
from dappo_batch._core import ConfigError

__all__ = ["Change", "Event", "Meta"]

_T = TypeVar("_T")


@dataclass(frozen=True)
class Event:
    """Something that a `Controller` noticed or did. What does not belong to its kind is None.

    Attributes
    ----------
    kind : str
        ``suspected``, ``diagnosed``, ``adapted``, ``withdrawn``, ``readings_lost`` or ``readings_back``.
    step : int
        Control steps since the start of the robot.
    robot : int
        Index of the robot.
    damage_class : int
        The most probable class (``diagnosed``), the one that the policy is told from now on (``adapted``), or
        the one that had been named (``withdrawn``).
    confidence : float
        Its probability (``diagnosed``).
    accepted : bool
        Whether that was enough to believe it (``diagnosed``).
    forward_velocity, expected : float
        Mean forward velocity over the last steps, and that of the class that the policy is told, m/s
        (``suspected``).
    residual : float
        Median residual over the last steps (``suspected``), or of the twin with the damage (``withdrawn``).
    healthy : float
        Median residual of the healthy twin (``withdrawn``).
    faults : int
        Entries of the observation that are not finite (``readings_lost``).
    """

    kind: str
    step: int
    robot: int = 0
    damage_class: int | None = None
    confidence: float | None = None
    accepted: bool | None = None
    forward_velocity: float | None = None
    expected: float | None = None
    residual: float | None = None
    healthy: float | None = None
    faults: int | None = None

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> Event:
        """Read an event as `adapt` and its JSON give it.

        Raises
        ------
        ConfigError
            If it has no kind or no step, or an entry has the wrong type.
        """
        what = "an event"
        found = mapping(found, what)
        kind, step = _entry(found, "event", str, what), _entry(found, "step", int, what)
        if kind is None or step is None:
            raise ConfigError(f"an event has no step or no kind: {shown(found)}")
        return cls(
            kind=kind,
            step=step,
            robot=_entry(found, "robot", int, what) or 0,
            damage_class=_entry(found, "class", int, what),
            confidence=_entry(found, "confidence", float, what),
            accepted=_entry(found, "accepted", bool, what),
            forward_velocity=_entry(found, "forward_velocity", float, what),
            expected=_entry(found, "expected", float, what),
            residual=_entry(found, "residual", float, what),
            healthy=_entry(found, "healthy", float, what),
            faults=_entry(found, "faults", int, what),
        )


@dataclass(frozen=True)
class Change:
    """A setting that changed when a run went on.

    Attributes
    ----------
    key : str
        Its dotted key.
    before, after : object
        Its values until then and from then on; None if it was absent.
    iteration, env_steps : int
        Iterations and env steps that were done before.
    """

    key: str
    before: Any
    after: Any
    iteration: int
    env_steps: int

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> Change:
        """Read an entry of ``changes`` in ``meta.json``.

        Raises
        ------
        ConfigError
            If an entry is missing or has the wrong type.
        """
        what = "a change"
        found = mapping(found, what)
        key = _entry(found, "key", str, what)
        iteration, env_steps = (_entry(found, name, int, what) for name in ("iteration", "env_steps"))
        if key is None or iteration is None or env_steps is None:
            raise ConfigError(f"a change has no key, iteration or env_steps: {shown(found)}")
        return cls(key, found.get("from"), found.get("to"), iteration, env_steps)


@dataclass(frozen=True)
class Meta:
    """What made a run, ``meta.json``; None is what a run of an older version does not say.

    Attributes
    ----------
    version, mujoco : str
        Versions of this package and of MuJoCo.
    backend, precision, device, physics : str
        What simulated the training, and the integrator.
    reward : str
        Name of the reward function.
    threads : int
        Worker threads.
    platform : str
        Operating system and processor architecture.
    command : tuple of str
        The command that started the run.
    changes : tuple of Change
        Settings that changed when the run went on, in order.
    """

    version: str | None = None
    mujoco: str | None = None
    backend: str | None = None
    precision: str | None = None
    device: str | None = None
    physics: str | None = None
    reward: str | None = None
    threads: int | None = None
    platform: str | None = None
    command: tuple[str, ...] = ()
    changes: tuple[Change, ...] = ()

    @classmethod
    def from_dict(cls, found: Mapping[str, Any]) -> Meta:
        """Read the content of ``meta.json``.

        Raises
        ------
        ConfigError
            If an entry has the wrong type.
        """
        what = "meta.json"
        found = mapping(found, what)
        texts = ("version", "mujoco", "backend", "precision", "device", "physics", "reward", "platform")
        return cls(
            **{name: _entry(found, name, str, what) for name in texts},
            threads=_entry(found, "threads", int, what),
            command=tuple(map(str, sequence(found.get("command", ()), "the command"))),
            changes=tuple(map(Change.from_dict, sequence(found.get("changes", ()), "the changes"))),
        )


def _entry(found: Mapping[str, Any], name: str, kind: type[_T], what: str) -> _T | None:
    """Return an entry of the right type; None where there is none."""
    value = found.get(name)
    if value is None:
        return None
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise ConfigError(f"{what}: {name} is {shown(value)}, expected a value of type {kind.__name__}")
    return value
