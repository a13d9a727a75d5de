"""Entries of a benchmark of trainings, and its command line."""

from __future__ import annotations

import argparse
import importlib.util
import json
from collections.abc import Callable, Sequence
from typing import Any, ClassVar

from dappo_batch._core import SimulationError
from dappo_batch.bench import measure
from dappo_batch.bench.simulators import Unavailable

from .worker import Work, Worker, WorkerFailed

__all__ = ["Entry", "WorkerEntry", "print_report"]


class Entry:
    """An entry of a benchmark, which may need packages of its own.

    Attributes
    ----------
    key : str
        Name in tables and JSON.
    about : str
        Description.
    packages : dict
        Packages it needs: name to import, name to install.
    note : str
        Remarks on this measurement, such as the version.
    """

    key: ClassVar[str]
    about: ClassVar[str]
    packages: ClassVar[dict[str, str]] = {}
    note: str = ""

    @classmethod
    def require(cls) -> None:
        """Raise `Unavailable` if a package is missing."""
        lacking = [name for module, name in cls.packages.items() if importlib.util.find_spec(module) is None]
        if lacking:
            verb = "is" if len(lacking) == 1 else "are"
            names = " and ".join(lacking)
            raise Unavailable(f"{names} {verb} not installed", f"pip install {' '.join(lacking)}")

    def close(self) -> None:
        """Free processes and memory."""


class WorkerEntry(Entry):
    """An entry whose program runs in a separate process for all rounds.

    Attributes
    ----------
    program : str
        Module and class that the process runs, see `tests.bench.worker`.
    """

    program: ClassVar[str]

    def start(self, task: Work) -> None:
        """Start the process, or raise `Unavailable` if its program cannot start."""
        try:
            self._worker = Worker(self.program, task)
        except WorkerFailed as error:
            raise Unavailable(str(error)) from error
        self.note = self._worker.note

    def ask(self, number: int) -> dict[str, Any]:
        """Let the program do work of the size `number`, and return its answer."""
        try:
            return self._worker.ask(number)
        except WorkerFailed as error:
            self.close()
            raise SimulationError(f"{self.key}: {error}") from error

    def close(self) -> None:
        """Free processes and memory."""
        self._worker.close()


def print_report(
    run: Callable[..., Any], parser: argparse.ArgumentParser, argv: Sequence[str] | None = None
) -> None:
    """Run a benchmark with the arguments of a command line and print its report, as JSON with ``--json``."""
    add = parser.add_argument
    add("--rounds", type=int, metavar="N", help="samples of each trainer, interleaved [default: 5]")
    add("--seconds", type=float, metavar="S", help="minimum duration of a sample of the machine [default: 2]")
    add("--json", action="store_true", default=False, help="print JSON")
    arguments = vars(parser.parse_args(argv))
    as_json = arguments.pop("json")
    report = run(**arguments, progress=measure.progress)
    print(json.dumps(report.to_dict(), indent=2) if as_json else report.text())
