"""Call of a command from Python, with its JSON objects as result."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from dappo_batch._checks import shown
from dappo_batch._core import ConfigError, run_command
from dappo_batch.commands.options import Callback

__all__ = ["invoke"]


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

    def receive(found: Any) -> bool | None:  # noqa: ANN401 - whatever JSON can hold
        objects.append(found)
        return callback(found) if callback else None

    given = {key: value for key, value in arguments.items() if value is not None}
    call = ", ".join(f"{key}={shown(value)}" for key, value in given.items())
    run_command(name, given, f"dappo_batch.{name}({call})", receive)
    return objects
