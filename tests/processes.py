"""Separate processes for tests, which end with the test together with their children."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

DAPPO_BATCH = (sys.executable, "-c", "from dappo_batch.cli import main; main()")
"""The command line of the package that this Python imports; arguments follow."""

_STARTED: list[subprocess.Popen[str]] = []
"""Running processes."""


def run(
    command: Sequence[str | Path],
    *,
    timeout: float,
    cwd: Path | None = None,
    env: Mapping[str, str] | None = None,
    **options: Any,  # noqa: ANN401
) -> subprocess.CompletedProcess[str]:
    """Run a command to its end; `timeout` (s) cuts it off, with every process that it has started.

    ``subprocess.run`` would end the command alone, and wait for those which hold its output open.
    """
    process = start(command, cwd=cwd, env=env, **options)
    try:
        out, err = process.communicate(timeout=timeout)
    except subprocess.TimeoutExpired as expired:
        raise subprocess.TimeoutExpired(process.args, timeout, *end(process)) from expired
    _STARTED.remove(process)
    return subprocess.CompletedProcess(process.args, process.returncode, out, err)


def start(command: Sequence[str | Path], **options: Any) -> subprocess.Popen[str]:  # noqa: ANN401
    """Start a command as leader of a process group, with pipes for its output."""
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    process = subprocess.Popen(
        list(map(str, command)), text=True, start_new_session=True, **(pipes | options)
    )
    _STARTED.append(process)
    return process


def end(process: subprocess.Popen[str]) -> tuple[str, str]:
    """Kill the process group of a process; return its output that has not been read yet."""
    if process.returncode is None:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
    if process in _STARTED:
        _STARTED.remove(process)
    return process.communicate()


def end_all() -> None:
    """End all remaining processes of :func:`start`."""
    for process in tuple(_STARTED):
        end(process)
