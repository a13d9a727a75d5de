"""Checks of arguments: a wrong type or value is a `ConfigError`, a wrong shape a `ShapeError`."""

from __future__ import annotations

import operator
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from os import PathLike, fsdecode, fsencode, stat
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from dappo_batch._core import ConfigError, ShapeError

__all__ = [
    "array",
    "boolean",
    "choice",
    "finite",
    "flags",
    "folder",
    "integer",
    "items",
    "listed",
    "mapping",
    "real",
    "sequence",
    "shown",
    "text",
]

Float = TypeVar("Float", np.float32, np.float64)

MOST_ITEMS = 2**24
"""Maximum length of a sequence: the maximum number of envs."""
MOST = 2**63 - 1
"""The largest integer that the native code accepts."""


def listed(names: Iterable[str], most: int = 12) -> str:
    """Return different names as a list, with the number of those that are left out."""
    every = list(dict.fromkeys(names))
    more = [f"and {len(every) - most} more"] if len(every) > most else []
    return ", ".join([*every[:most], *more])


def shown(value: object) -> str:
    """Return a value for an error message, shortened."""
    try:
        text = repr(value)
    except Exception:
        text = f"an object of type {type(value).__name__}"
    return text if len(text) <= 80 else f"{text[:77]}..."


def integer(value: object, what: str, minimum: int, maximum: int = MOST) -> int:
    """Return `value` as an int; floats and booleans are errors.

    Raises
    ------
    ConfigError
        If `value` is not an integer or lies outside its range.
    """
    if isinstance(value, bool | np.bool_):
        raise ConfigError(f"{what} must be an integer, got {value!r}")
    try:
        number = operator.index(value)  # type: ignore[arg-type]
    except TypeError:
        raise ConfigError(f"{what} must be an integer, got {shown(value)}") from None
    if number < minimum:
        raise ConfigError(f"{what} must be at least {minimum}, got {shown(number)}")
    if number > maximum:
        raise ConfigError(f"{what} must be at most {maximum}, got {shown(number)}")
    return number


def real(value: object, what: str) -> float:
    """Return `value` as a finite float."""
    if isinstance(value, bool | np.bool_ | str | bytes):
        raise ConfigError(f"{what} must be a number, got {shown(value)}")
    try:
        number = float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
        raise ConfigError(f"{what} must be a number, got {shown(value)}") from None
    if not np.isfinite(number):
        raise ConfigError(f"{what} must be finite, got {number}")
    return number


def boolean(value: object, what: str) -> bool:
    """Return `value`, which must be a boolean, as a bool."""
    if not isinstance(value, bool | np.bool_):
        raise ConfigError(f"{what} must be True or False, got {shown(value)}")
    return bool(value)


def text(value: object, what: str) -> str:
    """Return `value` as a str that can be written as UTF-8 and contains no NUL."""
    if not isinstance(value, str) or "\0" in value:
        raise ConfigError(f"{what} must be a text, got {shown(value)}")
    try:
        value.encode()
    except UnicodeEncodeError:
        raise ConfigError(f"{what} cannot be written as UTF-8, got {shown(value)}") from None
    return str(value)


def choice(value: object, what: str, choices: Sequence[str]) -> str:
    """Return `value`, which must be one of `choices`."""
    if not isinstance(value, str) or value not in choices:
        raise ConfigError(f"{what} must be one of {', '.join(map(repr, choices))}, got {shown(value)}")
    return str(value)


def folder(value: object, what: str) -> Path:
    """Return the path of a file or folder."""
    if isinstance(value, str | bytes | PathLike):
        path = fsdecode(value)
        # Bytes that are not UTF-8 become lone surrogates, which paths may contain; other surrogates are
        # errors.
        with suppress(UnicodeEncodeError):
            if path and b"\0" not in fsencode(path):
                _check_name(path, what)
                return Path(path)
    raise ConfigError(f"{what} must be a path, got {shown(value)}")


def _check_name(path: str, what: str) -> None:
    """Raise if the system cannot stat a path, for example because its name is too long."""
    try:
        stat(path)
    except (FileNotFoundError, NotADirectoryError):
        return
    except OSError as error:
        raise ConfigError(f"{what} {shown(path)} cannot be used: {error.strerror}") from None


def mapping(value: object, what: str) -> Mapping[Any, Any]:
    """Return `value`, which must be a mapping."""
    if not isinstance(value, Mapping):
        raise ConfigError(f"{what} must be a mapping such as a dict, got {shown(value)}")
    return value


def sequence(value: object, what: str) -> Sequence[Any]:
    """Return `value`, which must be a sequence other than a text."""
    if not isinstance(value, Sequence) or isinstance(value, str | bytes | bytearray):
        raise ConfigError(f"{what} must be a sequence such as a list, got {shown(value)}")
    return value


def items(value: Any) -> list[Any] | None:  # noqa: ANN401 - any argument
    """Return the items of a sequence or of an array of any library; None for a single value or a text."""
    is_sequence = isinstance(value, Sequence) and not isinstance(value, str | bytes | bytearray)
    if not is_sequence and not (isinstance(getattr(value, "ndim", None), int) and value.ndim > 0):
        return None
    if len(value) > MOST_ITEMS:  # checked before a range is expanded
        raise ConfigError(f"{shown(value)} has more than {MOST_ITEMS} entries")
    return list(value)


def array(value: object, what: str, dtype: type[Float]) -> NDArray[Float]:
    """Return real numbers as a C-contiguous array, without a copy if `value` is one.

    Raises
    ------
    ShapeError
        If `value` is not an array, for example because its rows differ in length.
    ConfigError
        If its entries are not real numbers.
    """
    try:
        found = np.asarray(value)
    except Exception as error:
        raise ShapeError(f"{what}: got no array but {shown(value)}: {error}") from None
    if found.dtype != dtype:
        if not np.can_cast(found.dtype, dtype, casting="same_kind"):
            raise ConfigError(
                f"{what}: expected {np.dtype(dtype)} or a type that converts to it, got {found.dtype}"
            )
        with np.errstate(over="ignore"):  # overflow becomes infinite, which is checked later
            found = found.astype(dtype)
    # `ascontiguousarray` would add a dimension to an array without dimensions.
    return np.ascontiguousarray(found) if found.ndim else found


def flags(value: object, what: str, count: int) -> NDArray[np.bool_]:
    """Return `count` booleans as an array.

    Raises
    ------
    ShapeError
        If there are not `count` values.
    ConfigError
        If they are not booleans.
    """
    try:
        found = np.asarray(value)
    except Exception as error:
        raise ShapeError(f"{what}: got no array but {shown(value)}: {error}") from None
    if found.shape != (count,):
        raise ShapeError(f"{what}: expected shape ({count},), got {found.shape}")
    if found.dtype != np.bool_:
        raise ConfigError(f"{what}: expected booleans, got {found.dtype}")
    return np.ascontiguousarray(found)


def finite(values: NDArray[Any], what: str) -> None:
    """Raise if an array contains a number that is not finite.

    Raises
    ------
    ConfigError
        If a number is NaN or infinite.
    """
    if not np.isfinite(values).all():
        at = tuple(int(index) for index in np.argwhere(~np.isfinite(values))[0])
        raise ConfigError(f"{what} must be finite, got {values[at]} at {list(at)}")
