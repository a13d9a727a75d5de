"""Metadata of a run, as frozen dataclasses; `from_dict` reads them from JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from dappo_batch._checks import mapping, sequence, shown
from dappo_batch._core import ConfigError
from dappo_batch.results.base import entry

__all__ = ["Change", "Meta"]


@dataclass(frozen=True)
class Change:
    """A setting that changed when a run was resumed.

    Attributes
    ----------
    key : str
        Dotted key of the setting.
    before, after : object
        Its values before and after the change; None if it was absent.
    iteration, env_steps : int
        Iterations and env steps before the change.
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
        key = entry(found, "key", str, what)
        iteration, env_steps = (entry(found, name, int, what) for name in ("iteration", "env_steps"))
        if key is None or iteration is None or env_steps is None:
            raise ConfigError(f"a change has no key, iteration or env_steps: {shown(found)}")
        return cls(key, found.get("from"), found.get("to"), iteration, env_steps)


@dataclass(frozen=True)
class Meta:
    """Metadata of a run, ``meta.json``; entries that a run of an older version lacks are None.

    Attributes
    ----------
    version, mujoco : str
        Versions of this package and of MuJoCo.
    backend, precision, device, physics : str
        Simulation of the training, and the integrator.
    reward : str
        Name of the reward function.
    threads : int
        Worker threads.
    platform : str
        Operating system and processor architecture.
    cpu, simd : str
        Name of the processor, and the vector instruction set of the lane engine and of the networks.
    command : tuple of str
        The command that started the run.
    changes : tuple of Change
        Settings that changed when the run was resumed, in order.
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
    cpu: str | None = None
    simd: str | None = None
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
        simulation = ("backend", "precision", "device", "physics", "reward")
        texts = ("version", "mujoco", *simulation, "platform", "cpu", "simd")
        return cls(
            **{name: entry(found, name, str, what) for name in texts},
            threads=entry(found, "threads", int, what),
            command=tuple(map(str, sequence(found.get("command", ()), "the command"))),
            changes=tuple(map(Change.from_dict, sequence(found.get("changes", ()), "the changes"))),
        )
