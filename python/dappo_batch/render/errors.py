"""Errors of rendering."""

from __future__ import annotations

from dappo_batch._core import DappoError

__all__ = ["RenderError"]


class RenderError(DappoError, RuntimeError):
    """Nothing can be drawn or encoded here; the message says what to install."""
