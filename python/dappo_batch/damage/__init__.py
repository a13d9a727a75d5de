"""Damage types. Each lies in its own file; a new one is added to `DAMAGE_TYPES` and named in a robot TOML."""

from __future__ import annotations

from dataclasses import MISSING, Field, fields
from typing import TYPE_CHECKING, Any, cast

from dappo_batch._core import ConfigError
from dappo_batch.damage.base import DamageType
from dappo_batch.damage.jammed_joint import JammedJoint
from dappo_batch.damage.missing_toe import MissingToe
from dappo_batch.damage.weak_motor import WeakMotor

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["DAMAGE_TYPES", "DamageType", "JammedJoint", "MissingToe", "WeakMotor", "make_damage_type"]

DAMAGE_TYPES: dict[str, type[DamageType]] = {kind.name: kind for kind in (JammedJoint, MissingToe, WeakMotor)}
"""Damage types by name. A program may add its own before it compiles a class table."""

_FIELD_TYPES: dict[str, tuple[type, ...]] = {
    "int": (int,),
    "float": (int, float),
    "bool": (bool,),
    "str": (str,),
}


def make_damage_type(name: str, options: Mapping[str, Any]) -> DamageType:
    """Make a damage type from its name and its parameters.

    Parameters
    ----------
    name : str
        A key of `DAMAGE_TYPES`.
    options : mapping
        Parameters, as in the table ``[damage.<name>]`` of a robot TOML.

    Returns
    -------
    DamageType
        The damage type.

    Raises
    ------
    ConfigError
        If the type or a parameter is unknown, missing, of the wrong type or out of range.
    """
    if name not in DAMAGE_TYPES:
        raise ConfigError(f"unknown damage type {name!r}: expected one of {', '.join(DAMAGE_TYPES)}")
    kind = DAMAGE_TYPES[name]
    # mypy cannot know that each concrete type is a dataclass.
    known: dict[str, Field[Any]] = {field.name: field for field in fields(cast("Any", kind))}
    if unknown := options.keys() - known.keys():
        raise ConfigError(
            f"{name}: unknown parameters {', '.join(sorted(unknown))}; expected {', '.join(known)}"
        )
    missing = [key for key, field in known.items() if field.default is MISSING and key not in options]
    if missing:
        raise ConfigError(f"{name}: missing parameters {', '.join(missing)}; write them into [damage.{name}]")
    for key, value in options.items():
        # Field types are text because of the postponed evaluation of annotations.
        expected: tuple[type, ...] = _FIELD_TYPES.get(str(known[key].type), (object,))
        if not isinstance(value, expected) or (isinstance(value, bool) and known[key].type != "bool"):
            raise ConfigError(f"{name}: {key} must be of type {known[key].type}, got {value!r}")
    return kind(**options)
