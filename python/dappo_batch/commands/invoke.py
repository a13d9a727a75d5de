"""From arguments of functions to a command line, and from what it prints to results."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from os import PathLike, fsdecode
from typing import Any

import numpy as np

from dappo_batch._checks import folder, mapping, shown, text
from dappo_batch._core import ConfigError, run_command
from dappo_batch.commands.options import Callback, Folder

__all__ = ["assignments", "invoke", "only"]

_SWITCHES = ("all_classes", "healthy", "unaware")
DEEPEST = 16
"""Parts of a setting's key, and levels of lists and mappings in its value, at most."""


_MOST_ITEMS = 100_000


def invoke(
    command: Sequence[str],
    options: Mapping[str, Any],
    callback: Callback | None = None,
    *,
    folders: Sequence[Folder] = (),
) -> list[dict[str, Any]]:
    """Run a command and return the objects that it would print; `folders` are its arguments without a flag.

    Raises
    ------
    ConfigError
        If an option cannot be written as an argument, or the command refuses it.
    """
    if callback is not None and not callable(callback):
        raise ConfigError(f"callback must be a function, got {shown(callback)}")
    objects: list[dict[str, Any]] = []

    def hear(told: dict[str, Any]) -> bool | None:
        objects.append(told)
        return callback(told) if callback else None

    paths = [str(folder(path, "a folder")) for path in folders]
    # What begins with a dash is a path all the same.
    run_command([*command, "--json", *_flags(options), *(["--", *paths] if paths else [])], hear)
    return objects


def only(objects: list[Any]) -> Any:  # noqa: ANN401 - whatever JSON can hold
    """Return the one object of a command that prints one."""
    (told,) = objects
    return told


def assignments(settings: Any, what: str = "set") -> list[str]:  # noqa: ANN401 - it is checked here
    """Return settings as the command line has them, ``key=value``.

    Raises
    ------
    ConfigError
        If they are no mapping from names to values that TOML has.
    """
    return list(_settings(mapping(settings, what), what, "", 1))


def _flags(options: Mapping[str, Any]) -> Iterator[str]:
    """Yield options as the command line has them; None and False are left out, and so is what is empty."""
    for name, value in options.items():
        flag = f"--{name.replace('_', '-')}"
        if value is None or (value is False and name in _SWITCHES):
            continue
        if name in ("set", "controller"):
            yield from (f"{flag}={assignment}" for assignment in assignments(value, name))
        elif value is True:
            yield flag
        elif isinstance(value, Sequence) and not isinstance(value, str | bytes | bytearray):
            yield from (f"{flag}={_argument(item, name)}" for item in _bounded(value, name))
        else:
            yield f"{flag}={_argument(value, name)}"


def _bounded(value: Sequence[Any], name: str) -> Sequence[Any]:
    """Return a sequence that a command line can hold; a range may be endless in practice."""
    if len(value[: _MOST_ITEMS + 1]) > _MOST_ITEMS:
        raise ConfigError(f"{name} must have at most {_MOST_ITEMS} entries, got {shown(value)}")
    return value


def _argument(value: Any, name: str) -> str:  # noqa: ANN401 - it is checked here
    if isinstance(value, PathLike) or (isinstance(value, str | bytes) and value):
        # Any text, as long as a command line can hold it.
        folder(value, name)
        return fsdecode(value)
    if isinstance(value, int | float | np.number) and not isinstance(value, bool):
        return str(value)
    raise ConfigError(f"{name} must be a text, a path or a number, got {shown(value)}")


def _settings(settings: Mapping[Any, Any], what: str, section: str, depth: int) -> Iterator[str]:
    """Yield settings as the command line has them; the keys of nested mappings are joined by dots."""
    if depth > DEEPEST:
        raise ConfigError(f"{what} is nested too deeply, at most {DEEPEST} levels are possible")
    for key, setting in settings.items():
        name = f"{section}{text(key, f'a key of {what}')}"
        if "=" in name:
            raise ConfigError(f"{what}: {shown(name)} is no name of a setting")
        if isinstance(setting, Mapping) and setting:
            yield from _settings(setting, what, f"{name}.", depth + 1)
        else:
            yield f"{name}={_toml(setting, name, depth)}"


def _toml(value: Any, name: str, depth: int = 1) -> str:  # noqa: ANN401 - whatever a setting can be
    """Return a value as TOML has it."""
    if depth > DEEPEST:
        raise ConfigError(f"{name} is nested too deeply, at most {DEEPEST} levels are possible")
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        if not -(2**63) <= value < 2**63:
            raise ConfigError(f"{name} must be between -2**63 and 2**63 - 1, got {shown(value)}")
        return str(value)
    if isinstance(value, float):
        return repr(value)
    if isinstance(value, PathLike):
        value = str(folder(value, name))
    if isinstance(value, str):
        return json.dumps(text(value, name), ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, Mapping):
        entries = (
            f"{_toml(text(key, f'a key of {name}'), name)} = {_toml(entry, name, depth + 1)}"
            for key, entry in value.items()
        )
        return f"{{{', '.join(entries)}}}"
    if isinstance(value, Sequence) and not isinstance(value, bytes | bytearray):
        return f"[{', '.join(_toml(item, name, depth + 1) for item in _bounded(value, name))}]"
    raise ConfigError(f"{name} must be a value that TOML has, such as a number or a text, got {shown(value)}")
