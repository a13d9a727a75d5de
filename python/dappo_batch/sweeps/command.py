"""``dappo-batch sweep``."""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from dappo_batch.sweeps import sweep
from dappo_batch.sweeps.cell import Cell
from dappo_batch.sweeps.worker import processes

__all__ = ["command"]


def command(*, out: Path, grid: Mapping[str, Sequence[Any]], base: Mapping[str, Any], jobs: int) -> int:
    """Run ``dappo-batch sweep``, see `sweep`, with `jobs` trainings at once, and return its exit code."""
    with processes(jobs) as pool:
        cells = sweep(base, grid, out, executor=pool, callback=_report)
    failed = sum(cell.error is not None for cell in cells)
    shown = os.fsencode(out).decode(errors="replace")
    print(f"{len(cells) - failed} of {len(cells)} trainings completed; folder of the sweep: {shown}")
    return 1 if failed else 0


def _report(cell: Cell) -> None:
    print(f"{cell.path.name}: {cell.error or 'done'}", file=sys.stderr, flush=True)
