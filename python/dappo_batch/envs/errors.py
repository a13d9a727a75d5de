"""What is raised before a reset."""

from __future__ import annotations

from gymnasium.error import ResetNeeded

from dappo_batch._core import SimulationError

__all__ = ["ResetNeededError"]


class ResetNeededError(SimulationError, ResetNeeded):
    """An env must be reset before it goes on; also Gymnasium's ``ResetNeeded``."""
