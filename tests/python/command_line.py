"""Run the command line, where a process is the point in one of its own, and read what it leaves behind."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO, Any

from dappo_batch._core import run_cli

from .. import processes

TINY = (
    *("--threads", "1", "--envs", "4", "--set"),
    *("horizon=16", "env.max_episode_steps=20", "ppo.hidden=[8]", "ppo.schedule=constant"),
    *("evaluation.episodes=1", "damage.max_damaged_limbs=1", "checkpoint.every=3"),
)
"""A training so small that a process spends most of its time on imports. Its learning rates do not
depend on the budget, so that a part of it is the beginning of the whole."""
ITERATION = 64
"""Env steps of one iteration of a tiny training."""


def dappo_batch(*arguments: str | Path, code: int = 0, cwd: Path | None = None) -> tuple[str, str]:
    """Run the command line in this process; return its standard output and error."""
    found, out, err = _in_process(arguments, cwd)
    assert found == code, (arguments, found, out, err)
    return out, err


def dappo_batch_many(*commands: tuple[str | Path, ...]) -> list[tuple[int, str, str]]:
    """Run commands one after the other in this process; return codes, outputs, errors."""
    return [_in_process(command, None) for command in commands]


def _in_process(arguments: tuple[str | Path, ...], cwd: Path | None) -> tuple[int, str, str]:
    with (
        contextlib.chdir(cwd or Path.cwd()),
        tempfile.TemporaryFile() as out,
        tempfile.TemporaryFile() as err,
    ):
        with _standard_stream(1, "stdout", out), _standard_stream(2, "stderr", err):
            code = run_cli(list(map(str, arguments)))
        texts = []
        for file in (out, err):
            file.seek(0)
            texts.append(file.read().decode())
    return code, texts[0], texts[1]


@contextlib.contextmanager
def _standard_stream(number: int, name: str, file: IO[bytes]) -> Iterator[None]:
    """Let Rust write here, which knows the file descriptor, and Python, whose stream is one of pytest's."""
    kept, kept_number = getattr(sys, name), os.dup(number)
    kept.flush()
    os.dup2(file.fileno(), number)
    try:
        with open(number, "w", closefd=False, encoding="utf-8") as stream:
            setattr(sys, name, stream)
            yield
    finally:
        setattr(sys, name, kept)
        os.dup2(kept_number, number)
        os.close(kept_number)


def start(*arguments: str | Path) -> subprocess.Popen[str]:
    """Start the command line in a process of its own without waiting for its end."""
    return processes.start([*processes.DAPPO_BATCH, *arguments])


def interrupt_when(condition: Callable[[], bool], *arguments: str | Path) -> str:
    """Start the command line and send Ctrl-C once the condition holds; return its standard error."""
    process = start(*arguments)
    deadline = time.monotonic() + 60
    while not condition() and process.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=60)
    assert process.returncode == 130, (arguments, process.returncode, err)
    return err


def read_lines(text: str) -> list[dict[str, Any]]:
    """Parse lines of metrics, without the times, which no two runs share."""
    lines = [json.loads(line) for line in text.splitlines()]
    return [{key: line[key] for key in line if not key.endswith("_seconds")} for line in lines]


def metrics(run: Path) -> list[dict[str, Any]]:
    """Read the metrics of a run, without the times."""
    return read_lines((run / "metrics.jsonl").read_text())


def files(folder: Path) -> dict[str, bytes]:
    """Read every file below a folder."""
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
