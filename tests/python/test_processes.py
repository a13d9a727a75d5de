"""Processes that tests start: one that is cut off takes with it what it has started."""

from __future__ import annotations

import subprocess
import time
from pathlib import Path

import pytest

from .. import processes


def state(pid: int) -> str:
    """Return the letter that the kernel shows for a process, Z for one that only waits to be collected."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0]
    except FileNotFoundError:
        return "Z"


def assert_ends(pid: int) -> None:
    """Wait until a process that was killed has gone."""
    deadline = time.monotonic() + 10
    while state(pid) != "Z":
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_a_command_that_is_cut_off_takes_its_children_with_it() -> None:
    # The child keeps the output open, so ending only the shell would block.
    with pytest.raises(subprocess.TimeoutExpired) as caught:
        processes.run(["bash", "-c", "sleep 600 & echo $!; wait"], timeout=1.0)
    assert_ends(int(caught.value.output))


def test_what_a_test_leaves_running_is_ended_after_it() -> None:
    process = processes.start(["bash", "-c", "sleep 600 & echo $!; wait"])
    assert process.stdout is not None
    child = int(process.stdout.readline())
    assert state(child) != "Z"
    processes.end_all()
    assert process.returncode is not None
    assert_ends(child)
