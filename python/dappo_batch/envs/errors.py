"""The error for envs that must be reset."""

from __future__ import annotations

from gymnasium.error import ResetNeeded

from dappo_batch._core import SimulationError

__all__ = ["ResetNeededError"]


class ResetNeededError(SimulationError, ResetNeeded):
    """An env must be reset before the next step; also Gymnasium's ``ResetNeeded``."""
