"""A process that tries one input after the other, and may crash.

What it is doing stands in a file that its supervisor maps, too; so the supervisor knows what it has died of.
"""

from __future__ import annotations

import faulthandler
import json
import mmap
import os
import resource
import shutil
import signal
import struct
import sys
import time
import warnings
from contextlib import suppress
from hashlib import sha256
from pathlib import Path
from random import Random

from .outcome import Fault, Output, attempt
from .room import Room
from .targets import TARGETS

ADDRESS_SPACE = 8 << 30
LARGEST_FILE = 256 << 20
ENDED = 3
"""Exit code of a worker that has done its share, or uses too much memory, and must be replaced."""
_SHARE = 20_000
_LARGEST_MEMORY = 1_500 << 20
_NOW = struct.Struct("<Qqd")  # number of the case, its target (-1: none), processor seconds before it


class Board:
    """Progress and counters of a worker, in a file that two processes map."""

    def __init__(self, path: Path) -> None:
        size = _NOW.size + 16 * len(TARGETS)
        if not path.exists():
            path.write_bytes(_NOW.pack(0, -1, 0.0) + bytes(16 * len(TARGETS)))
        with path.open("r+b") as file:
            self._map = mmap.mmap(file.fileno(), size)

    def begin(self, number: int, target: int) -> None:
        """Note that a case begins; target -1 for none."""
        _NOW.pack_into(self._map, 0, number, target, time.process_time())

    @property
    def now(self) -> tuple[int, int, float]:
        """Number of the case, its target, and the processor seconds of the process before it."""
        number, target, used = _NOW.unpack_from(self._map, 0)
        return number, target, used

    def count(self, target: int, accepted: bool) -> None:
        """Count an input that was accepted or refused."""
        at = _NOW.size + 16 * target + 8 * accepted
        struct.pack_into("<Q", self._map, at, struct.unpack_from("<Q", self._map, at)[0] + 1)

    def counts(self) -> dict[str, tuple[int, int]]:
        """Return refused and accepted inputs by target."""
        pairs = struct.iter_unpack("<QQ", self._map[_NOW.size :])
        return dict(zip(TARGETS, pairs, strict=True))


def case_name(seed: int, worker: int, number: int) -> str:
    """Return the name of a case, from which its input is made."""
    return f"{seed}-{worker}-{number}"


def target_of(case: str, names: list[str]) -> str:
    """Choose the kind of input of a case."""
    weights = [TARGETS[name][1] for name in names]
    return Random(case).choices(names, weights)[0]


def record(out: Path, target: str, case: str, fault: Fault, room: Path) -> None:
    """Append a fault to the list; keep the input of the first few of a kind."""
    entry = {
        "kind": fault.kind,
        "where": fault.where,
        "what": fault.what[:300],
        "target": target,
        "case": case,
    }
    line = json.dumps({**entry, "signature": fault.signature}) + "\n"
    with (out / "faults.jsonl").open("a") as file:
        file.write(line)
    kept = out / "inputs" / sha256(fault.signature.encode()).hexdigest()[:12]
    kept.mkdir(parents=True, exist_ok=True)
    if len(list(kept.iterdir())) < 3:
        folder = kept / f"{target}-{case}"
        with suppress(shutil.Error):  # pipes cannot be copied
            shutil.copytree(room, folder / "files", symlinks=True, dirs_exist_ok=True)
        (folder / "what.txt").write_text(f"{fault.signature}\n\n{fault.detail}", errors="backslashreplace")


def main(out: Path, base: Path, seed: int, worker: int, names: list[str]) -> int:
    """Try inputs until the share is done."""
    resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE))
    resource.setrlimit(resource.RLIMIT_FSIZE, (LARGEST_FILE, LARGEST_FILE))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    warnings.simplefilter("ignore")
    faulthandler.enable()
    faulthandler.register(signal.SIGUSR1, all_threads=True)
    board = Board(out / f"worker-{worker}.board")
    output = Output(out / f"worker-{worker}.output")
    room = Room(base, out / f"worker-{worker}.room")
    order = list(TARGETS)
    with output.caught():
        output.take()
        first = board.now[0]
        for number in range(first, first + _SHARE):
            case = case_name(seed, worker, number)
            target = target_of(case, names)
            index = order.index(target)
            board.begin(number, index)
            accepted, fault = attempt(target, case, room, output)
            board.begin(number + 1, -1)
            board.count(index, accepted)
            if fault is not None:
                record(out, target, case, fault, room.folder)
            room.clear()
            if number % 64 == 0 and _memory() > _LARGEST_MEMORY:
                break
    return ENDED


def _memory() -> int:
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE")


if __name__ == "__main__":
    arguments = json.loads(sys.argv[1])
    sys.exit(main(Path(arguments.pop("out")), Path(arguments.pop("base")), **arguments))
