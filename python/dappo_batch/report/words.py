"""Numbers as text."""

from __future__ import annotations

import numpy as np

__all__ = ["grouped_digits", "percent", "rounded", "share"]

_UNKNOWN = "n/a"


def rounded(value: float | None, digits: int = 1) -> str:
    """Return a number with `digits` decimals, or a text for unknown values."""
    if value is None or not np.isfinite(value):
        return _UNKNOWN
    text = f"{value:.{digits}f}"
    # Zero has no sign.
    return text if float(text) else text.lstrip("-")


def grouped_digits(value: int) -> str:
    """Return a whole number with its digits in groups of three."""
    return f"{value:,}".replace(",", " ")


def share(part: float, whole: float) -> str:
    """Return a part of a whole in per cent."""
    return f"{100 * part / whole:.1f} %" if whole > 0 and np.isfinite(part) else _UNKNOWN


def percent(value: float | None) -> str:
    """Return a share from 0 to 1 in per cent."""
    return _UNKNOWN if value is None else f"{100 * value:.2f} %"
