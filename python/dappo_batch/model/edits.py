"""The changes of an MJCF by ``[simplify]`` and ``[[override]]``, and the faults of these tables."""

from __future__ import annotations

import numpy as np

from dappo_batch.results import Edit

__all__ = ["EditLog", "shown_number"]


class EditLog:
    """Collects changes and faults.

    Attributes
    ----------
    faults : list of str
        Reasons why an entry cannot be applied.
    """

    def __init__(self) -> None:
        self.faults: list[str] = []
        self._parts: dict[tuple[str, str, str, str], list[str]] = {}

    def record(self, table: str, entry: str, part: str, before: object, after: object) -> None:
        """Record that a value of a part was changed, or of the whole model if `part` is empty."""
        one, other = shown_number(before), shown_number(after)
        if one != other:
            parts = self._parts.setdefault((table, entry, one, other), [])
            parts += [part] if part else []

    @property
    def edits(self) -> tuple[Edit, ...]:
        """The changes; equal ones of several parts are one."""
        return tuple(
            Edit(table, entry, tuple(parts), before, after)
            for (table, entry, before, after), parts in self._parts.items()
        )


def shown_number(value: object) -> str:
    """Return a number, or an array of them, as text."""
    if isinstance(value, str):
        return value
    numbers = np.asarray(value, dtype=float)
    if numbers.ndim == 0:
        return f"{float(numbers):.6g}"
    return f"[{', '.join(f'{number:.6g}' for number in numbers.tolist())}]"
