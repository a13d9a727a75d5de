"""The outcome of an input: a valid result, a typed error, or a fault."""

from __future__ import annotations

import os
import re
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from random import Random

from dappo_batch import DappoError

from .room import BadExit, Room
from .targets import TARGETS

_NUMBERS = re.compile(r"0x[0-9a-f]+|\d+")
_PANIC = re.compile(r"panicked at ([^\n]*):\d+:\n?([^\n]*)")
_TRACE = "Traceback (most recent call last)"


@dataclass(frozen=True)
class Fault:
    """An input that reveals a bug.

    Attributes
    ----------
    kind : str
        ``panic``, ``abort``, ``hang``, ``untyped``, ``exit`` or ``wrong``, an invalid result.
    where : str
        Place in the code, as far as known.
    what : str
        The message.
    detail : str
        Traces, calls and output.
    """

    kind: str
    where: str
    what: str
    detail: str

    @property
    def signature(self) -> str:
        """Equal for inputs that reveal the same bug."""
        what = self.what.partition(":")[0] if self.kind == "untyped" else _NUMBERS.sub("#", self.what)[:80]
        return f"{self.kind} {self.where} {what}"


class Output:
    """Standard output and error of this process, in a file that is read after each case."""

    def __init__(self, path: Path) -> None:
        self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND)

    @contextmanager
    def caught(self) -> Iterator[None]:
        """Redirect the output of this process, in Python and native code, to the file."""
        sys.stdout.flush()
        sys.stderr.flush()
        before, streams = [os.dup(1), os.dup(2)], (sys.stdout, sys.stderr)
        os.dup2(self._file, 1)
        os.dup2(self._file, 2)
        # Under pytest these go elsewhere.
        file = os.fdopen(os.dup(self._file), "w", errors="backslashreplace")
        sys.stdout = sys.stderr = file
        try:
            yield
        finally:
            file.close()
            sys.stdout, sys.stderr = streams
            for number, old in enumerate(before, start=1):
                os.dup2(old, number)
                os.close(old)

    def take(self) -> str:
        """Return what was printed since the last call."""
        sys.stdout.flush()
        sys.stderr.flush()
        size = os.fstat(self._file).st_size
        text = os.pread(self._file, min(size, 1 << 20), 0) if size else b""
        os.ftruncate(self._file, 0)
        return text.decode(errors="replace")


def attempt(target: str, case: str, room: Room, output: Output) -> tuple[bool, Fault | None]:
    """Try an input; return whether it was accepted, and the fault, if there is one."""
    function, _ = TARGETS[target]
    error: BaseException | None = None
    try:
        function(Random(f"{target}:{case}"), room)
    except DappoError:
        accepted = False
    except BaseException as raised:  # a panic is no Exception
        error, accepted = raised, False
    else:
        accepted = not any(room.codes)
    return accepted, _fault(error, room, output.take())


def _fault(error: BaseException | None, room: Room, printed: str) -> Fault | None:
    trace = "" if error is None else "".join(traceback.format_exception(error))
    detail = "\n".join([*room.notes, trace, printed[-20_000:]])
    if panic := _PANIC.search(printed):
        return Fault("panic", panic[1], panic[2], detail)
    if error is not None and (
        type(error).__name__ == "PanicException" or "has died" in str(error) or "panicked" in str(error)
    ):
        return Fault("panic", _place(error, room), str(error), detail)
    if isinstance(error, BadExit):
        return Fault("exit", " ".join(room.notes[-1:])[:60], str(error), detail)
    if isinstance(error, AssertionError):
        return Fault("wrong", _place(error, room), str(error), detail)
    if error is not None:
        return Fault("untyped", _place(error, room), f"{type(error).__name__}: {error}", detail)
    if _TRACE in printed:
        last = printed[printed.rindex(_TRACE) :]
        files = re.findall(r'File "[^"]*?([^/"]+/[^/"]+)", line (\d+)', last)
        message = re.findall(
            r"^(?:\w+\.)*\w+(?:Error|Exception|Warning).*$|^Exception.*$", last, re.MULTILINE
        )
        return Fault("untyped", ":".join(files[-1]) if files else "", message[-1] if message else "", detail)
    return None


def _place(error: BaseException, room: Room) -> str:
    """Return the line of the package that raised, or for one in Rust the function that was called."""
    ours = [frame for frame in traceback.extract_tb(error.__traceback__) if "/dappo_batch/" in frame.filename]
    if not ours:
        return room.notes[-1].partition("(")[0] if room.notes else ""
    return f"{'/'.join(Path(ours[-1].filename).parts[-2:])}:{ours[-1].lineno}"
