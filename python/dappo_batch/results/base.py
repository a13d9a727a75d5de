"""Base of all results: dataclasses that can be written as JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from types import NoneType, UnionType
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

from dappo_batch._checks import shown
from dappo_batch._core import ConfigError

__all__ = ["Result", "entry"]

_T = TypeVar("_T")
_R = TypeVar("_R", bound="Result")

_KEYS = {"damage_class": "class"}
"""JSON keys that are reserved words in Python, by field."""


@dataclass(frozen=True)
class Result:
    """Base of all results."""

    def to_dict(self) -> dict[str, Any]:
        """Return a dictionary that can be written as JSON, with the keys that ``--json`` prints."""
        names = (field.name for field in fields(self))
        return {_KEYS.get(name, name): _plain(getattr(self, name)) for name in names}

    @classmethod
    def from_dict(cls: type[_R], found: Mapping[str, Any]) -> _R:
        """Create a result from the dictionary of `to_dict`."""
        entries = {name: _typed(kind, _found(found, name, kind)) for name, kind in _kinds(cls).items()}
        return cls(**entries)


def _kinds(cls: type[Result]) -> dict[str, Any]:
    """Return the types of the fields by name."""
    hints = get_type_hints(cls)
    return {field.name: hints[field.name] for field in fields(cls)}


def _found(found: Mapping[str, Any], name: str, kind: Any) -> Any:  # noqa: ANN401 - whatever a field is
    """Return the entry of a field; None for one that may be None and is missing, as in earlier files."""
    key = _KEYS.get(name, name)
    return found.get(key) if isinstance(kind, UnionType) else found[key]


def _typed(kind: Any, value: Any) -> Any:  # noqa: ANN401 - whatever a field is
    if value is None:
        return None
    if isinstance(kind, UnionType):
        (kind,) = (one for one in get_args(kind) if one is not NoneType)
    if get_origin(kind) is tuple:
        return tuple(_typed(get_args(kind)[0], item) for item in value)
    if isinstance(kind, type) and issubclass(kind, Result):
        return kind.from_dict(value)
    return value


def _plain(value: Any) -> Any:  # noqa: ANN401
    if isinstance(value, tuple):
        return [_plain(item) for item in value]
    return value.to_dict() if isinstance(value, Result) else value


def entry(found: Mapping[str, Any], name: str, kind: type[_T], what: str) -> _T | None:
    """Return an entry after a check of its type; None if it is missing.

    Raises
    ------
    ConfigError
        If it has another type; the message begins with `what`.
    """
    value = found.get(name)
    if value is None:
        return None
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise ConfigError(f"{what}: {name} is {shown(value)}, expected a value of type {kind.__name__}")
    return value
