"""Pages of the documentation: their fenced blocks, and how to run the commands in them."""

from __future__ import annotations

import os
import re
import shlex
import sys
from pathlib import Path
from typing import NamedTuple

from .. import processes
from .command_line import dappo_batch

ROOT = Path(__file__).resolve().parents[2]
SECONDS = 240  # far more than any block needs: only a hang is cut off

FENCE = re.compile(r"^```([^\n]*)\n(.*?)^```", re.MULTILINE | re.DOTALL)

# The documentation shows sizes that a reader wants; a test wants small ones.
SMALLER = {
    "--envs": "4",
    "--episodes": "1",
    "--seconds": "0.05",
    "--rounds": "1",
    "--rollouts": "4",
    "--at": "10",
}
SMALL_TRAINING = (
    "--set horizon=16 env.max_episode_steps=20 evaluation.episodes=1 ppo.epochs=1 ppo.value_epochs=1"
)


class Block(NamedTuple):
    """A fenced block of a page: commands or code, which a test may run, or a file that the reader saves."""

    language: str
    runnable: bool
    file: str | None
    text: str


def name_of(path: Path) -> str:
    return str(path.relative_to(ROOT))


def blocks(page: Path) -> list[Block]:
    found = []
    for info, text in FENCE.findall(page.read_text(encoding="utf-8")):
        words = info.split()
        assert words, f"{name_of(page)}: a fenced block names no language"
        language, *marks = words
        files = [mark for mark in marks if re.fullmatch(rf"[\w-]+\.{language}", mark)]
        assert marks in ([], ["runnable"], files[:1]), f"{name_of(page)}: unknown mark in ```{info}"
        found.append(Block(language, marks == ["runnable"], files[0] if files else None, text))
    return found


def run(command: list[str], folder: Path) -> str:
    environment = os.environ | {
        # `python` and `dappo-batch` are those of the interpreter that runs the tests.
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONWARNINGS": "error",
    }
    done = processes.run(command, cwd=folder, env=environment, timeout=SECONDS)
    assert done.returncode == 0, f"{command}\n{done.stdout[-2000:]}\n{done.stderr[-2000:]}"
    return done.stdout


def run_line(line: str, folder: Path) -> None:
    """Run a command of this package in this process, and what needs a shell in one."""
    if line.startswith("dappo-batch ") and not set("|;&<>$*?#\\`(") & set(line):
        dappo_batch(*shlex.split(line)[1:], cwd=folder)
    else:
        run(["bash", "-euo", "pipefail", "-c", line], folder)


def shrunk(line: str) -> str:
    """Return a command line of the documentation with sizes that take a second."""
    if not line.startswith("dappo-batch "):
        return line
    for option, value in SMALLER.items():
        line = re.sub(rf"{option} \S+", f"{option} {value}", line)
    if line.startswith("dappo-batch train"):
        if "--resume" in line:
            return re.sub(r"--steps \S+", "--steps 256", line)
        line = re.sub(r" --(steps|envs) \S+", "", line)
        return f"{line} --steps 128 --envs 4 {SMALL_TRAINING}"
    if line.startswith("dappo-batch render"):
        return f"{line} --steps 20"
    if line.startswith("dappo-batch diagnose train"):
        return f"{line.split(' --set ')[0]} --set epochs=1"
    return line
