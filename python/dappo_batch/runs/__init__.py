"""Run folders: their configuration, metrics and tables, and the robot that they mean."""

from __future__ import annotations

from dappo_batch.runs.run import Run, load_run

__all__ = ["Run", "load_run"]
