"""A contender in a process of its own: it works when asked, and waits at a pipe while others are measured.

It makes a `Program` and then answers each line of its standard input, a number, with a line of JSON. It ends
with its input.
"""

from __future__ import annotations

import contextlib
import importlib
import json
import os
import subprocess
import sys
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any, ClassVar, Protocol

from .limits import thread_limits

__all__ = ["Program", "Work", "Worker", "WorkerFailed", "main"]

_ROOT = Path(__file__).parents[2]
"""The repository, from which this folder can be imported."""


class Work(Protocol):
    """What a program is made with: a dataclass of what JSON can hold."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def threads(self) -> int:
        """Threads that the program may use."""


class Program(Protocol):
    """What runs inside of a worker.

    Attributes
    ----------
    note : str
        Versions, and what else should be known about this run.
    """

    note: str

    def answer(self, number: float) -> dict[str, Any]:
        """Do a piece of work of the size `number` and say what it was."""

    def close(self) -> None:
        """Free processes and memory."""


class WorkerFailed(Exception):
    """A worker ended by itself; the text holds what it said last."""


class Worker:
    """A running worker.

    Parameters
    ----------
    program : str
        Module and class of the `Program`, joined by a colon.
    task : Work
        What it is made with.

    Raises
    ------
    WorkerFailed
        If the program cannot be made.
    """

    def __init__(self, program: str, task: Work) -> None:
        # A file and not a pipe: nobody reads while it works, and a full pipe would stop it.
        self._said = tempfile.TemporaryFile()  # noqa: SIM115 (lives as long as the worker)
        command = [sys.executable, "-m", "tests.bench.worker", program, _name(type(task))]
        self._process = subprocess.Popen(
            [*command, json.dumps(asdict(task))],
            cwd=_ROOT,
            env={**os.environ, **thread_limits(task.threads)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            text=True,
        )
        try:
            self.note = str(self._read()["note"])
        except WorkerFailed:
            self.close()
            raise

    def ask(self, number: float) -> dict[str, Any]:
        """Have a piece of work of the size `number` done and return what the program says about it."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # reading will tell
            print(number, file=self._process.stdin, flush=True)
        return self._read()

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if line:
            answer: dict[str, Any] = json.loads(line)
            return answer
        code = self._process.wait()
        self._said.seek(0)
        said = self._said.read().decode(errors="replace").strip()
        raise WorkerFailed(f"its process ended with exit code {code}: {said[-500:] or 'it said nothing'}")

    def close(self) -> None:
        """Let the process end; a second call does nothing."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()
        try:
            self._process.wait(timeout=30.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._said.close()


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _named(name: str) -> Any:  # noqa: ANN401 (whatever it is)
    module, _, attribute = name.partition(":")
    return getattr(importlib.import_module(module), attribute)


def main(program: str, kind: str, task: str) -> None:
    """Be the worker."""
    # Libraries print what they like; only answers may reach the other side.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    served: Program = _named(program)(_named(kind)(**json.loads(task)))
    try:
        print(json.dumps({"note": served.note}), file=answers, flush=True)
        for line in sys.stdin:
            print(json.dumps(served.answer(float(line))), file=answers, flush=True)
    finally:
        served.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
