"""From functions to commands, and from the objects that commands hand over to results."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dappo_batch._checks import shown
from dappo_batch._core import ConfigError, check_settings, run_command
from dappo_batch.commands.options import Callback

__all__ = ["assignments", "invoke"]


def invoke(name: str, arguments: Mapping[str, Any], callback: Callback | None = None) -> list[Any]:
    """Run a command and return the objects that ``--json`` would print.

    Raises
    ------
    ConfigError
        If an argument is unknown, of the wrong type or out of range.
    """
    if callback is not None and not callable(callback):
        raise ConfigError(f"callback must be a function, got {shown(callback)}")
    objects: list[Any] = []

    def hear(told: Any) -> bool | None:  # noqa: ANN401 - whatever JSON can hold
        objects.append(told)
        return callback(told) if callback else None

    given = {key: value for key, value in arguments.items() if value is not None}
    call = ", ".join(f"{key}={shown(value)}" for key, value in given.items())
    run_command(name, given, f"dappo_batch.{name}({call})", hear)
    return objects


def assignments(settings: object, what: str = "set") -> None:
    """Refuse settings that no command takes.

    Raises
    ------
    ConfigError
        If they are no mapping from names to values that TOML has.
    """
    check_settings(settings, what)
