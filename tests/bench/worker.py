"""A trainer in a separate process, which waits at a pipe while others are measured.

It creates a `Program` and then answers each line of its standard input, a number, with a line of JSON. It
exits at the end of its input.
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
    """The settings of a program: a dataclass that can be written as JSON."""

    __dataclass_fields__: ClassVar[dict[str, Any]]

    @property
    def threads(self) -> int:
        """Threads that the program may use."""


class Program(Protocol):
    """A program that runs in a worker.

    Attributes
    ----------
    note : str
        Versions and other remarks on this measurement.
    """

    note: str

    def answer(self, number: float) -> dict[str, Any]:
        """Do work of the size `number` and return its measurements."""

    def close(self) -> None:
        """Free processes and memory."""


class WorkerFailed(Exception):
    """A worker exited; the text contains the end of its output."""


class Worker:
    """A running worker.

    Parameters
    ----------
    program : str
        Module and class of the `Program`, joined by a colon.
    task : Work
        Settings of the program.

    Raises
    ------
    WorkerFailed
        If the program cannot start.
    """

    def __init__(self, program: str, task: Work) -> None:
        # A file and not a pipe, which would block when full.
        self._stderr = tempfile.TemporaryFile()  # noqa: SIM115 (lives as long as the worker)
        command = [sys.executable, "-m", "tests.bench.worker", program, _name(type(task))]
        self._process = subprocess.Popen(
            [*command, json.dumps(asdict(task))],
            cwd=_ROOT,
            env={**os.environ, **thread_limits(task.threads)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._stderr,
            text=True,
        )
        try:
            self.note = str(self._read()["note"])
        except WorkerFailed:
            self.close()
            raise

    def ask(self, number: float) -> dict[str, Any]:
        """Let the program do work of the size `number`, and return its answer."""
        assert self._process.stdin is not None
        with contextlib.suppress(BrokenPipeError):  # reading raises
            print(number, file=self._process.stdin, flush=True)
        return self._read()

    def _read(self) -> dict[str, Any]:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if line:
            answer: dict[str, Any] = json.loads(line)
            return answer
        code = self._process.wait()
        self._stderr.seek(0)
        output = self._stderr.read().decode(errors="replace").strip()
        raise WorkerFailed(f"its process ended with exit code {code}: {output[-500:] or 'no output'}")

    def close(self) -> None:
        """End the process; a second call does nothing."""
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                with contextlib.suppress(BrokenPipeError):
                    pipe.close()
        try:
            self._process.wait(timeout=30.0)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        self._stderr.close()


def _name(kind: type) -> str:
    return f"{kind.__module__}:{kind.__qualname__}"


def _load(name: str) -> Any:  # noqa: ANN401 (any attribute)
    module, _, attribute = name.partition(":")
    return getattr(importlib.import_module(module), attribute)


def main(program: str, kind: str, task: str) -> None:
    """Run a worker."""
    # Libraries may print to standard output, which carries only answers.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    served: Program = _load(program)(_load(kind)(**json.loads(task)))
    try:
        print(json.dumps({"note": served.note}), file=answers, flush=True)
        for line in sys.stdin:
            print(json.dumps(served.answer(float(line))), file=answers, flush=True)
    finally:
        served.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
