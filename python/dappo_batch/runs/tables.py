"""Tables of run folders as NumPy arrays."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dappo_batch._core import CheckpointError, read_file

__all__ = ["Table", "columns", "read_csv", "read_text"]

_LARGE = 2**63

Table = Mapping[str, NDArray[Any]]
"""Columns of equal length, by name."""

# Columns that are text even if all entries are numbers or empty.
_TEXT = frozenset(
    {
        "assumed",
        "backend",
        "damage",
        "device",
        "event",
        "group",
        "method",
        "name",
        "physics",
        "precision",
        "robot",
    }
)


def read_text(path: Path, errors: str = "strict") -> str:
    """Read a text in UTF-8.

    Run folders may be from untrusted sources: links, pipes, devices and very large files are errors.

    Raises
    ------
    CheckpointError
        If it cannot be read.
    """
    try:
        return read_file(path).decode("utf-8", errors)
    except OSError as error:
        raise CheckpointError(f"{path} cannot be read: {error.strerror}") from error
    except UnicodeDecodeError as error:
        raise CheckpointError(f"{path} cannot be read: {error}") from error


def read_csv(path: Path, required: Sequence[str] = (), earlier: Mapping[str, str] | None = None) -> Table:
    """Read a table with a header.

    Parameters
    ----------
    path : Path
        The file.
    required : sequence of str
        Columns that it must have.
    earlier : mapping from str to str, optional
        Names that earlier versions wrote, and today's names of the same columns.

    Returns
    -------
    Table
        Whole numbers as int64, others as float64 with NaN for empty entries, ``true`` and ``false`` as bool,
        everything else as str.

    Raises
    ------
    CheckpointError
        If the file cannot be read, a row is too short or too long, or a column is missing.
    """
    text = read_text(path)
    try:
        header, *rows = [row for row in csv.reader(io.StringIO(text, newline="")) if row]
    except csv.Error as error:
        raise CheckpointError(f"{path} cannot be read: {error}") from error
    except ValueError as error:
        raise CheckpointError(f"{path} is empty, expected a table with a header") from error
    header = [(earlier or {}).get(name, name) for name in header]
    for number, row in enumerate(rows, start=2):
        if len(row) != len(header):
            raise CheckpointError(
                f"{path}: row {number} has {len(row)} entries, expected {len(header)} as in the header"
            )
    if lacking := [name for name in required if name not in header]:
        raise CheckpointError(
            f"{path} has no column {', '.join(lacking)}; its columns are {', '.join(header)}"
        )
    return {name: _parse(name, [row[index] for row in rows]) for index, name in enumerate(header)}


def columns(rows: Sequence[Mapping[str, Any]]) -> Table:
    """Return rows as columns; missing or null numbers are NaN, missing texts are empty.

    Raises
    ------
    CheckpointError
        If an entry is neither a number nor a text.
    """
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: _array(name, [row.get(name) for row in rows]) for name in names}


def _array(name: str, values: Sequence[Any]) -> NDArray[Any]:
    if any(isinstance(value, str) for value in values):
        return np.array(["" if value is None else str(value) for value in values])
    if all(isinstance(value, int) and abs(value) < _LARGE for value in values):
        return np.array(values, np.bool_ if all(isinstance(value, bool) for value in values) else np.int64)
    try:
        column = np.array([np.nan if value is None else value for value in values], np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise CheckpointError(f"`{name}` has entries that are neither numbers nor texts: {error}") from error
    if column.ndim != 1:
        raise CheckpointError(f"`{name}` has entries that are lists, expected numbers or texts")
    return column


def _parse(name: str, texts: Sequence[str]) -> NDArray[Any]:
    if name not in _TEXT:
        if texts and set(texts) <= {"true", "false"}:
            return np.array([text == "true" for text in texts])
        if (whole := _whole(texts)) is not None:
            return np.array(whole, np.int64)
        if (real := _numbers(float, (text or "nan" for text in texts))) is not None:
            return np.array(real, np.float64)
    return np.array(texts, np.str_)


def _numbers(kind: Callable[[str], float], texts: Iterable[str]) -> list[float] | None:
    try:
        return [kind(text) for text in texts]
    except (ValueError, OverflowError):
        return None


def _whole(texts: Iterable[str]) -> list[int] | None:
    """Return whole numbers that fit into an int64, or None."""
    numbers = _numbers(int, texts)
    if numbers is None or any(abs(number) >= _LARGE for number in numbers):
        return None
    return [int(number) for number in numbers]
