"""Runs a third-party program in a separate process."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from .. import processes

SECONDS = 800  # far more than any program needs: only a hang is cut off


def run_program(arguments: list[str], folder: Path) -> str:
    """Run the interpreter with `arguments` in `folder`; returns what it prints."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    done = processes.run([sys.executable, *arguments], cwd=folder, env=environment, timeout=SECONDS)
    assert done.returncode == 0, f"{arguments}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout
