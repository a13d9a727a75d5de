"""Run the console script in processes of their own, and read what it leaves behind."""

from __future__ import annotations

import json
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

PROGRAM = (sys.executable, "-c", "from dappo_batch.cli import main; main()")
TINY = (
    *("--threads", "1", "--envs", "4", "--set"),
    *("horizon=16", "env.max_episode_steps=20", "ppo.hidden=[8]"),
    *("evaluation.episodes=1", "damage.max_damaged_limbs=1", "checkpoint.every=3"),
)
"""A training so small that a process spends most of its time on imports."""
ITERATION = 64
"""Env steps of one iteration of a tiny training."""


def dappo_batch(*arguments: str | Path, code: int = 0, cwd: Path | None = None) -> tuple[str, str]:
    """Run the command line; return its standard output and error."""
    command = [*PROGRAM, *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, timeout=120, check=False)
    assert done.returncode == code, (command, done.returncode, done.stdout, done.stderr)
    return done.stdout, done.stderr


_MANY = """
import json, sys
from dappo_batch._core import run_cli
for arguments in json.loads(sys.argv[1]):
    code = run_cli(arguments)
    print(f"code {code}", flush=True)
    print(f"code {code}", file=sys.stderr, flush=True)
"""


def dappo_batch_many(*commands: tuple[str | Path, ...]) -> list[tuple[int, str, str]]:
    """Run commands one after the other in one process, to save its start; return codes, outputs, errors."""
    arguments = json.dumps([list(map(str, command)) for command in commands])
    program = [sys.executable, "-c", _MANY, arguments]
    done = subprocess.run(program, capture_output=True, text=True, timeout=120, check=True)
    outputs, errors = (
        re.split(r"^code (\d+)\n", text, flags=re.MULTILINE) for text in (done.stdout, done.stderr)
    )
    return [(int(outputs[2 * i + 1]), outputs[2 * i], errors[2 * i]) for i in range(len(commands))]


def start(*arguments: str | Path) -> subprocess.Popen[str]:
    """Start the command line without waiting for its end."""
    command = [*PROGRAM, *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


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
