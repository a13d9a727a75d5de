"""One error for several faults of a robot."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dappo_batch._core import ConfigError, DappoError

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["raise_faults"]

_MOST_SHOWN = 20


def raise_faults(what: str, faults: Sequence[str], error: type[DappoError] = ConfigError) -> None:
    """Raise an error with all faults of `what`, if there are any.

    Raises
    ------
    DappoError
        Of the class `error`, if there is a fault.
    """
    if not faults:
        return
    if len(faults) == 1:
        raise error(f"{what}: {faults[0]}")
    shown = list(faults[:_MOST_SHOWN])
    if more := len(faults) - len(shown):
        shown.append(f"and {more} more")
    lines = "".join(f"\n  - {fault}" for fault in shown)
    raise error(f"{what} has {len(faults)} faults:{lines}")
