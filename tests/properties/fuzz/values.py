"""Invalid values of arguments and files."""

from __future__ import annotations

import math
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

INTEGERS = (
    0,
    1,
    -1,
    2,
    3,
    7,
    2**31 - 1,
    2**31,
    2**32,
    2**53 + 1,
    2**63 - 1,
    2**63,
    2**64,
    -(2**63) - 1,
    10**30,
)
FLOATS = (0.0, -0.0, 0.5, -1.5, 1e-320, 1e-9, 1e9, 1e308, math.nan, math.inf, -math.inf)
STRINGS = (
    *("", " ", "x", "0", "-1", "nan", "true", "healthy", "auto", "..", "a/b", "é", "\0", "\n", "'", '"'),
    *("%s{}$(x)", "--json", "=", "a=b", "@", "+", "x" * 5000, "ant", "jammed_joint@0", "\U0001f996", "1e999"),
    *("[" * 3000, '{"x":' * 3000, "x = [[" * 9),
)

# Only what TOML and JSON can write.
_WRITTEN: tuple[Callable[[], Any], ...] = (
    lambda: None,
    lambda: True,
    lambda: False,
    list,
    dict,
    lambda: [None],
    lambda: [[], {}],
    lambda: [1, "x", 2.5],
    lambda: [0.5] * 40,
    lambda: {"x": 1},
    lambda: {"": {"": []}},
)

_OBJECTS: tuple[Callable[[], Any], ...] = (
    lambda: 1j,
    lambda: b"",
    lambda: b"\xff\0x",
    lambda: "\ud800",
    lambda: (),
    lambda: (0, 1),
    lambda: (3, 1),
    set,
    lambda: {1},
    object,
    lambda: Path("run"),
    lambda: Path("missing"),
    lambda: Decimal("0.1"),
    lambda: range(3),
    lambda: range(2**62),
    lambda: iter([1, 2]),
    lambda: lambda *_: 1 / 0,
    lambda: type,
    lambda: {"damage_class": [1], "onset": 0},
    lambda: {None: 1},
    lambda: {1: 1.0, "healthy": 2},
    lambda: [[1, 2], [3]],
    lambda: ["healthy", 1],
    lambda: [True, False],
    lambda: np.int64(1),
    lambda: np.uint64(2**64 - 1),
    lambda: np.float32(math.nan),
    lambda: np.bool_(True),
    lambda: np.str_("healthy"),
    lambda: np.datetime64("nat"),
    lambda: np.array(None),
    lambda: np.array(3),
    lambda: np.array("healthy"),
    lambda: np.array([]),
    lambda: np.array([1, 2]),
    lambda: np.array(["healthy", "x"]),
    lambda: np.array([object()]),
    lambda: np.zeros((0, 4), np.float32),
    lambda: np.ma.masked_all(3),
)


def integer(rng: Random) -> int:
    """Return a small, a negative or a huge number."""
    return rng.choice(INTEGERS) if rng.random() < 0.8 else rng.randrange(-9, 99)


def number(rng: Random) -> float:
    """Return a number that a file can hold."""
    return integer(rng) if rng.random() < 0.5 else rng.choice(FLOATS)


def written(rng: Random) -> Any:  # noqa: ANN401
    """Return a value that TOML or JSON can write."""
    kind = rng.randrange(4)
    if kind == 0:
        return integer(rng)
    if kind == 1:
        return rng.choice(FLOATS)
    return rng.choice(STRINGS) if kind == 2 else rng.choice(_WRITTEN)()


def anything(rng: Random) -> Any:  # noqa: ANN401
    """Return any value at all."""
    return written(rng) if rng.random() < 0.5 else rng.choice(_OBJECTS)()


def array(rng: Random, shape: tuple[int, ...], dtype: type = np.float32) -> Any:  # noqa: ANN401
    """Return an array of this shape, or one with odd entries, shape, dtype or layout, or another value."""
    if rng.random() < 0.15:
        return anything(rng)
    sizes = list(shape)
    if rng.random() < 0.3 and sizes:
        sizes[rng.randrange(len(sizes))] = rng.choice((0, 1, 2, 5))
    if rng.random() < 0.1:
        sizes = sizes[1:] if rng.random() < 0.5 else [1, *sizes]
    values = np.zeros(sizes, dtype)
    if values.size and np.issubdtype(dtype, np.floating):
        for _ in range(rng.randrange(4)):
            values.flat[rng.randrange(values.size)] = rng.choice((math.nan, math.inf, -1e30, 1e38, 0.5))
    elif values.size:
        values.flat[rng.randrange(values.size)] = rng.choice((-1, 1, 2, 100, 2**31 - 1))
    shape_of = rng.randrange(8)
    if shape_of == 0:
        return values.astype(rng.choice(("f8", "f2", "i4", "i8", "u8", "?", "c8", "O", "U3", ">f4")))
    if shape_of == 1:
        return values.tolist()
    if shape_of == 2:
        return np.asfortranarray(values)
    return values[..., ::-1] if shape_of == 3 and values.ndim else values
