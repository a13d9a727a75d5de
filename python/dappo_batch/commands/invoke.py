"""From arguments of functions to a command line, and from what it prints to results."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike, fsdecode
from typing import Any

from dappo_batch._core import run_command
from dappo_batch.commands.options import Callback

__all__ = ["invoke", "only"]


def invoke(
    command: list[str], options: Mapping[str, Any], callback: Callback | None = None
) -> list[dict[str, Any]]:
    """Run a command and return the objects that it would print."""
    objects: list[dict[str, Any]] = []

    def hear(told: dict[str, Any]) -> bool | None:
        objects.append(told)
        return callback(told) if callback else None

    run_command([*command, "--json", *_flags(options)], hear)
    return objects


def only(objects: list[Any]) -> Any:  # noqa: ANN401 - whatever JSON can hold
    """Return the one object of a command that prints one."""
    (told,) = objects
    return told


def _flags(options: Mapping[str, Any]) -> list[str]:
    """Return options as the command line has them; None and False are left out, and so is what is empty."""
    flags: list[str] = []
    for name, value in options.items():
        flag = f"--{name.replace('_', '-')}"
        if value is None or value is False:
            continue
        if value is True:
            flags.append(flag)
        elif isinstance(value, Mapping):
            flags += [flag, *_settings(value)] if value else []
        elif isinstance(value, (bytes, PathLike)):
            flags += [flag, fsdecode(value)]
        elif isinstance(value, Sequence) and not isinstance(value, str):
            flags += [flag, *map(fsdecode, value)] if value else []
        else:
            flags += [flag, str(value)]
    return flags


def _settings(settings: Mapping[str, Any], section: str = "") -> Iterator[str]:
    """Yield settings as the command line has them; the keys of nested mappings are joined by dots."""
    for key, setting in settings.items():
        if isinstance(setting, Mapping):
            yield from _settings(setting, f"{section}{key}.")
        else:
            yield f"{section}{key}={json.dumps(setting)}"
