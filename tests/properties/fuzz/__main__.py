"""Try odd inputs for some minutes, in worker processes that are restarted when one kills them."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

from .outcome import Fault, Output, attempt
from .room import Room, prepare
from .targets import TARGETS
from .worker import ENDED, Board, case_name, record

_REPORT_SECONDS = 60.0


def main() -> int:
    """Run the command; the exit code is 1 if there were faults."""
    parser = argparse.ArgumentParser(prog="python -m tests.properties.fuzz", description=__doc__)
    add = parser.add_argument
    add("--minutes", type=float, default=60.0, help="how long [default: 60]")
    add("--workers", type=int, default=len(os.sched_getaffinity(0)), metavar="N", help="processes")
    add("--seed", type=int, default=0, metavar="S", help="other inputs for another number [default: 0]")
    add(
        "--limit",
        type=float,
        default=30.0,
        metavar="SECONDS",
        help="longest processor time of an input [default: 30]",
    )
    add(
        "--out",
        type=Path,
        default=Path("target/fuzz"),
        metavar="DIR",
        help="where faults go [default: target/fuzz]",
    )
    add(
        "--only",
        nargs="+",
        choices=list(TARGETS),
        default=list(TARGETS),
        metavar="KIND",
        help="kinds of input",
    )
    add(
        "--replay",
        metavar="KIND:CASE",
        help="try one input again, as faults.jsonl names it, and show everything",
    )
    arguments = parser.parse_args()
    if arguments.replay:
        return _replay(arguments.replay)
    out = arguments.out.absolute()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    base = out / "base"
    with Output(out / "prepare.txt").caught():
        prepare(base)
    # Memory is faster than a disk, where there is such a folder.
    fast = Path(tempfile.mkdtemp(prefix="dappo-fuzz-", dir="/dev/shm" if Path("/dev/shm").is_dir() else None))
    try:
        shutil.copytree(base, fast / "base")
        workers = [
            Worker(out, fast, arguments.seed, number, arguments.only) for number in range(arguments.workers)
        ]
        _supervise(workers, out, arguments.minutes * 60.0, arguments.limit)
        return _summary(workers, out)
    finally:
        shutil.rmtree(fast, ignore_errors=True)


class Worker:
    """A process that is restarted when it ends."""

    def __init__(self, out: Path, fast: Path, seed: int, number: int, names: list[str]) -> None:
        self.out, self.fast, self.seed, self.number, self.names = out, fast, seed, number, names
        self.board = Board(fast / f"worker-{number}.board")
        self._process = self._start()
        self._seen = (-1, 0.0, 0.0)

    def _start(self) -> subprocess.Popen[bytes]:
        options = {"out": str(self.fast), "base": str(self.fast / "base"), "seed": self.seed}
        text = json.dumps({**options, "worker": self.number, "names": self.names})
        return subprocess.Popen(
            [sys.executable, "-m", "tests.properties.fuzz.worker", text], stdin=subprocess.DEVNULL
        )

    def look(self, limit: float) -> None:
        """Restart the process if it has ended; stop it if its input takes too long."""
        number, target, used = self.board.now
        code = self._process.poll()
        if code is not None:
            if code != ENDED:
                self._blame("abort", f"the process ended with code {code}", number, target)
            self._process = self._start()
        elif target >= 0 and self._is_late(number, used, limit) and self.board.now[0] == number:
            os.kill(self._process.pid, signal.SIGUSR1)
            time.sleep(0.5)
            self.stop()
            self._blame("hang", f"no answer in {limit:g} s", number, target)
            self._process = self._start()

    def _is_late(self, number: int, used: float, limit: float) -> bool:
        """Whether an input has used too much processor time, or has waited too long."""
        try:
            fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        except OSError:
            return False
        cpu, now = sum(map(int, fields[11:13])) / os.sysconf("SC_CLK_TCK"), time.monotonic()
        if (number, cpu) != self._seen[:2]:
            self._seen = (number, cpu, now)
        # A process that stands still may have to wait for others.
        return cpu - used > limit or now - self._seen[2] > 4.0 * limit

    def _blame(self, kind: str, what: str, number: int, target: int) -> None:
        printed = (self.fast / f"worker-{self.number}.output").read_text(errors="replace")[-20_000:]
        name = list(TARGETS)[target] if target >= 0 else "start"
        case = case_name(self.seed, self.number, number)
        lines = [line for line in printed.splitlines() if "dappo_batch" in line or "allocation" in line]
        # The calls are lost with the process; the case can be replayed.
        room = self.fast / f"worker-{self.number}.room" / "a" / "room"
        record(self.fast, name, case, Fault(kind, lines[0][:100] if lines else "", what, printed), room)
        self.board.begin(number + 1, -1)
        if target >= 0:
            self.board.count(target, accepted=False)

    def stop(self) -> None:
        """End the process."""
        self._process.kill()
        self._process.wait()


def _supervise(workers: list[Worker], out: Path, seconds: float, limit: float) -> None:
    began = shown = time.monotonic()
    try:
        while time.monotonic() - began < seconds:
            time.sleep(0.2)
            for worker in workers:
                worker.look(limit)
            if time.monotonic() - shown > _REPORT_SECONDS:
                shown = time.monotonic()
                _summary(workers, out)
    except KeyboardInterrupt:
        pass
    finally:
        for worker in workers:
            worker.stop()


def _summary(workers: list[Worker], out: Path) -> int:
    """Write and print the findings so far."""
    fast = workers[0].fast
    refused: Counter[str] = Counter()
    accepted: Counter[str] = Counter()
    for worker in workers:
        for name, (no, yes) in worker.board.counts().items():
            refused[name] += no
            accepted[name] += yes
    if (fast / "faults.jsonl").exists():
        shutil.copy(fast / "faults.jsonl", out)
        for done in (fast / "inputs").glob("*/*/what.txt"):  # written last
            kept = out / done.parent.relative_to(fast)
            if not kept.exists():
                shutil.copytree(done.parent, kept, symlinks=True)
    path = out / "faults.jsonl"
    faults = [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []
    kinds = Counter(fault["kind"] for fault in faults)
    inputs = {name: {"refused": refused[name], "accepted": accepted[name]} for name in TARGETS}
    total = sum(refused.values()) + sum(accepted.values())
    signatures = Counter(fault["signature"] for fault in faults)
    summary = {
        "total": total,
        "inputs": inputs,
        "faults": dict(kinds),
        "signatures": dict(signatures.most_common()),
    }
    (out / "summary.json").write_text(json.dumps(summary, indent=2))
    found = ", ".join(f"{count} {kind}" for kind, count in kinds.items()) or "no faults"
    print(
        f"{total} inputs, {sum(accepted.values())} of them accepted: {found}; {out / 'summary.json'}",
        flush=True,
    )
    return 1 if faults else 0


def _replay(name: str) -> int:
    target, _, case = name.partition(":")
    with tempfile.TemporaryDirectory(prefix="dappo-fuzz-") as folder:
        root = Path(folder)
        prepare(root / "base")
        room = Room(root / "base", root / "room")
        output = Output(root / "output")
        with output.caught():
            output.take()
            accepted, fault = attempt(target, case, room, output)
        print("\n".join(room.notes))
        print("accepted" if accepted else "refused or failed")
        if fault is not None:
            print(f"{fault.signature}\n{fault.detail}")
        os.chdir("/")
    return 0 if fault is None else 1


if __name__ == "__main__":
    sys.exit(main())
