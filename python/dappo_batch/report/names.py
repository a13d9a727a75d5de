"""Short names of paths in figures and tables."""

from __future__ import annotations

import os
import re
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

__all__ = ["short_names"]

_LONGEST = 32
_WORD = re.compile(r"[^-_., /]*[-_., /]*")


def short_names(paths: Sequence[Path]) -> dict[Path, str]:
    """Return a name of at most 32 characters for every path, without the words that all of them begin with.

    Names differ where paths do.
    """
    if not paths:
        return {}
    above = os.path.commonpath([path.parent for path in paths])
    # All files of a kind have the same extension.
    texts = [os.path.relpath(path.with_suffix("") if path.is_file() else path, above) for path in paths]
    words = [_WORD.findall(text) for text in texts]
    while (
        len(words) > 1
        and all(_has_letter(rest[1:]) for rest in words)
        and len({one[0] for one in words}) == 1
    ):
        words = [rest[1:] for rest in words]
    names = [_cut("".join(rest)) for rest in words]
    often = Counter(names)
    # Long names may differ only in the middle, which is cut out.
    numbered = (f"{name} {place}" if often[name] > 1 else name for place, name in enumerate(names, start=1))
    return dict(zip(paths, numbered, strict=True))


def _has_letter(words: Sequence[str]) -> bool:
    """Return whether a name consists of more than a number, such as a seed."""
    return any(letter.isalpha() for word in words for letter in word)


def _cut(name: str) -> str:
    if len(name) <= _LONGEST:
        return name
    half = (_LONGEST - 5) // 2  # leaves room for a number
    return f"{name[:half]}…{name[-half:]}"
