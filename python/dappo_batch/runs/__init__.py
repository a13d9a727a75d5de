"""Run folders: their configuration, metrics, tables and robot."""

from __future__ import annotations

from dappo_batch.runs.run import Run, load_run

__all__ = ["Run", "load_run"]
