"""Valid inputs made invalid: by bytes, by words and by structure."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from random import Random
from typing import Any

from . import values

_WORD = re.compile(r'"[^"\n]*"|[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?|\w+|[\[\]{}<>=,/]')


def raw(rng: Random, data: bytes) -> bytes:
    """Change, cut, repeat or insert bytes."""
    changed = bytearray(data)
    for _ in range(rng.choice((1, 1, 1, 2, 4))):
        at = rng.randrange(len(changed) + 1)
        kind = rng.randrange(6)
        if kind == 0 and at < len(changed):
            changed[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            changed[at : at + 1] = bytes([rng.choice((0, 1, 0x7F, 0x80, 0xFF))])
        elif kind == 2:
            del changed[at : at + rng.choice((1, 2, 4, 8, 64))]
        elif kind == 3:
            changed[at:at] = changed[at : at + rng.choice((1, 4, 16))]
        elif kind == 4:
            size = rng.choice((4, 8))
            odd = rng.choice((0, 1, 2**31 - 1, 2**32 - 1, 2**63 - 1, 2**64 - 1)) % 256**size
            changed[at : at + size] = odd.to_bytes(size, rng.choice(("little", "big")))
        elif rng.random() < 0.3:
            del changed[at:]
    return bytes(changed)


def text(rng: Random, source: str) -> str:
    """Change words, numbers, strings, lines or single characters of a text."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        kind = rng.randrange(6)
        if kind <= 2 and (words := list(_WORD.finditer(source))):
            word = rng.choice(words)
            source = source[: word.start()] + _other_word(rng, word.group(), words) + source[word.end() :]
        elif kind == 3:
            lines = source.split("\n")
            at = rng.randrange(len(lines))
            moved = lines.pop(at)
            if rng.random() < 0.6:
                for _ in range(rng.choice((1, 2))):
                    lines.insert(rng.randrange(len(lines) + 1), moved)
            source = "\n".join(lines)
        elif kind == 4:
            at = rng.randrange(len(source) + 1)
            source = source[:at] + rng.choice(values.STRINGS) + source[at + rng.randrange(3) :]
        elif rng.random() < 0.2:
            source = source[: rng.randrange(len(source) + 1)]
    return source


def _other_word(rng: Random, word: str, words: list[re.Match[str]]) -> str:
    kind = rng.randrange(4)
    if kind == 0:
        return rng.choice(words).group()
    if word.startswith('"') and kind <= 2:
        return json.dumps(rng.choice(values.STRINGS), ensure_ascii=False)
    if kind == 3:
        return ""
    return scalar(values.number(rng))


def tree(rng: Random, source: Any) -> Any:  # noqa: ANN401
    """Change nested tables and lists: a value, a key, an entry more or less. The source stays as it is."""
    changed = _copy(source)
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        places = list(_places(changed))
        if not places:
            return values.written(rng)
        holder, key = rng.choice(places)
        kind = rng.randrange(8)
        if kind <= 3:
            holder[key] = _near(rng, holder[key])
        elif kind == 4:
            holder[key] = values.written(rng)
        elif kind == 5:
            del holder[key]
        elif kind == 6:
            other, name = rng.choice(places)
            holder[key] = _copy(other[name])
        elif isinstance(holder, dict):
            holder[rng.choice(values.STRINGS)] = _copy(holder[key])
        else:
            holder.insert(rng.randrange(len(holder) + 1), _copy(holder[key]))
    return changed


def value(rng: Random, source: Any) -> Any:  # noqa: ANN401
    """Change a value or its content."""
    changed = tree(rng, {"": source})
    return changed.get("", source) if isinstance(changed, dict) else changed


def _near(rng: Random, value: Any) -> Any:  # noqa: ANN401
    """Return another value of the same kind, which passes the first checks."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return rng.choice((value + 1, value - 1, -value, values.integer(rng)))
    if isinstance(value, float):
        return rng.choice((-value, value * 1e6, value / 1e6, rng.choice(values.FLOATS)))
    if isinstance(value, str):
        return rng.choice((value + "x", value[:-1], value.upper(), rng.choice(values.STRINGS)))
    if isinstance(value, list):
        return rng.choice((value[:-1], value + value[:1], value[::-1], []))
    return values.written(rng)


def _copy(value: Any) -> Any:  # noqa: ANN401
    if isinstance(value, dict):
        return {key: _copy(item) for key, item in value.items()}
    return [_copy(item) for item in value] if isinstance(value, list) else value


def _places(value: Any) -> Iterator[tuple[Any, Any]]:  # noqa: ANN401
    """Yield every holder and key within a tree, of long lists of numbers the ends alone."""
    if isinstance(value, dict):
        keys: list[Any] = list(value)
    elif isinstance(value, list):
        keys = list(range(len(value))) if len(value) <= 16 else [0, 1, len(value) - 1]
    else:
        return
    for key in keys:
        yield value, key
        yield from _places(value[key])


def scalar(value: Any) -> str:  # noqa: ANN401
    """Return a number, string or truth value as TOML has it, and JSON but for the infinite."""
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, float):
        return repr(value) if math.isfinite(value) else str(value)
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def to_toml(value: Any, top: bool = True) -> str:  # noqa: ANN401
    """Return a tree as TOML, everything below the first level inline; what TOML cannot write is left out."""
    if isinstance(value, dict):
        pairs = [
            f"{scalar(str(key))} = {to_toml(item, top=False)}"
            for key, item in value.items()
            if item is not None
        ]
        return "\n".join(pairs) + "\n" if top else "{" + ", ".join(pairs) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(to_toml(item, top=False) for item in value if item is not None) + "]"
    return scalar(value)
