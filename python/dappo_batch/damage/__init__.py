"""Damage types, one in each file; programs add others with `register_damage_type`."""

from __future__ import annotations

import re
from dataclasses import MISSING, Field, fields, is_dataclass
from typing import TYPE_CHECKING, Any, TypeVar, cast

from dappo_batch._checks import shown
from dappo_batch._core import ConfigError
from dappo_batch.damage.base import DamageType, MovingLimits
from dappo_batch.damage.dead_motor import DeadMotor
from dappo_batch.damage.jammed_joint import JammedJoint
from dappo_batch.damage.missing_limb import MissingLimb
from dappo_batch.damage.missing_shank import MissingShank
from dappo_batch.damage.weak_motor import WeakMotor

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = [
    "DAMAGE_TYPES",
    "DamageType",
    "DeadMotor",
    "JammedJoint",
    "MissingLimb",
    "MissingShank",
    "MovingLimits",
    "WeakMotor",
    "default_options",
    "make_damage_type",
    "register_damage_type",
]

DAMAGE_TYPES: dict[str, type[DamageType]] = {
    "jammed_joint": JammedJoint,
    "missing_shank": MissingShank,
    "missing_toe": MissingShank,
    "missing_limb": MissingLimb,
    "weak_motor": WeakMotor,
    "dead_motor": DeadMotor,
}
"""Damage types by name; `register_damage_type` adds to them. ``missing_toe`` is another name of
``missing_shank``, that of the robots of the paper."""

_FIELD_TYPES: dict[str, tuple[type, ...]] = {
    "int": (int,),
    "float": (int, float),
    "bool": (bool,),
    "str": (str,),
    "int | str": (int, str),
    "int | str | None": (int, str),
    "str | float": (str, int, float),
    "float | None": (int, float),
}


_Kind = TypeVar("_Kind", bound=type[DamageType])

_NAME = re.compile(r"[a-z][a-z0-9_]*")

_RESERVED = ("max_damaged_limbs", "max_damages_per_limb", "modules", "severity", "types")
"""Names of other entries of the section ``[damage]``."""


def register_damage_type(kind: _Kind) -> _Kind:
    """Register a damage type by its name, for robot TOMLs, configurations and damage specs in this process.

    Parameters
    ----------
    kind : type
        A frozen dataclass derived from `DamageType`. One with the module and name of a registered class
        replaces it, as when the cell of a notebook runs again.

    Returns
    -------
    type
        `kind` itself, so that this can be used as a decorator above ``@dataclass(frozen=True)``.

    Raises
    ------
    ConfigError
        If `kind` is not such a class, or its name is invalid or belongs to another type.

    Examples
    --------
    >>> @register_damage_type
    ... @dataclass(frozen=True)
    ... class RustyJoints(DamageType):
    ...     name: ClassVar[str] = "rusty_joints"
    ...     factor: float
    ...     def apply(self, spec, limb, severity):
    ...         for name in limb.joints:
    ...             spec.joint(name).damping *= 1 + severity * (self.factor - 1)
    """
    if not (isinstance(kind, type) and issubclass(kind, DamageType)):
        raise ConfigError(f"a damage type must be a class derived from DamageType, got {shown(kind)}")
    owner = f"the damage type {kind.__qualname__}"
    if not is_dataclass(kind) or not kind.__dataclass_params__.frozen:
        raise ConfigError(f"{owner} must be a dataclass: write @dataclass(frozen=True) above it")
    if kind.__abstractmethods__:
        raise ConfigError(f"{owner} must define {', '.join(sorted(kind.__abstractmethods__))}")
    name = getattr(kind, "name", None)
    if not isinstance(name, str) or not _NAME.fullmatch(name) or name in _RESERVED:
        raise ConfigError(
            f"{owner} must have a name of lower-case letters, digits and _, other than"
            f" {', '.join(_RESERVED)}, got {shown(name)}"
        )
    known = DAMAGE_TYPES.get(name)
    if known and (known.__module__, known.__qualname__) != (kind.__module__, kind.__qualname__):
        raise ConfigError(
            f"{owner}: the name {name!r} belongs to {known.__module__}.{known.__qualname__}; choose another"
        )
    DAMAGE_TYPES[name] = kind
    return kind


def default_options(name: str) -> dict[str, Any]:
    """Return the parameters of a damage type that have a default; those of an unknown type are empty."""
    known = fields(cast("Any", DAMAGE_TYPES[name])) if name in DAMAGE_TYPES else ()
    return {field.name: field.default for field in known if field.default is not MISSING}


def make_damage_type(name: str, options: Mapping[str, Any]) -> DamageType:
    """Create a damage type from its name and parameters.

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
    # mypy does not know that concrete types are dataclasses.
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
