"""Who takes part in a benchmark: what can be made here, and what cannot and why."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TypeVar

from dappo_batch.bench.contenders import Unavailable
from dappo_batch.bench.report import Missing

__all__ = ["enter"]

T = TypeVar("T")


def enter(
    makers: Mapping[str, Callable[[], T]], progress: Callable[[str], None]
) -> tuple[list[T], list[Missing]]:
    """Make everything that can run here, and say why the rest cannot.

    Parameters
    ----------
    makers : mapping
        From the key of a contender to what makes it or raises `Unavailable`.
    progress : callable
        Told what is made.
    """
    made: list[T] = []
    missing: list[Missing] = []
    for key, make in makers.items():
        progress(f"making {key}")
        try:
            made.append(make())
        except Unavailable as reason:
            missing.append(Missing(key, str(reason), reason.install))
    return made, missing
