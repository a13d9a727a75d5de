"""``python -m tests.gpu``: the GPU engine on this machine, with MuJoCo, the lane engine and mujoco_warp.

It needs no network. Each phase is a process of its own with a time limit, so that a driver that hangs or
crashes ends one phase; those for which no time is left are reported as skipped. Findings are printed and
written to ``findings.json`` after each phase, and the output of all phases to ``log.txt``.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

from dappo_batch.runs.run import read_lines

from ..processes import run
from .machine import vulkan_driver
from .phase import PHASES

_LEAST = 5.0
"""Time that no phase can do without, s."""


class Check:
    """The findings so far, which are written to a file after every phase.

    Parameters
    ----------
    out : Path
        Folder of the findings.
    scale : str
        Name of a scale.
    devices : dict
        Environment variables that choose the devices.
    seconds : float
        Time budget of the whole check.
    """

    def __init__(self, out: Path, scale: str, devices: dict[str, str], seconds: float) -> None:
        self.findings: dict[str, dict[str, Any]] = {}
        self._out, self._scale, self._environment = out, scale, os.environ | devices
        self._end = time.monotonic() + seconds

    def phase(self, name: str, limit: float) -> None:
        """Run a phase if there is time, at most `limit` seconds, and print its findings."""
        start = time.monotonic()
        seconds = min(limit, self._end - start)
        found: dict[str, Any] = {"ended": "skipped: no time left"}
        if seconds > _LEAST:
            found = self._run(name, seconds)
        found["seconds"] = round(time.monotonic() - start, 1)
        self.findings[name] = found
        (self._out / "findings.json").write_text(json.dumps(self.findings, indent=2) + "\n")
        print(f"{name} ({found['seconds']} s): {found['ended']}")
        for row in found.get("rows", ()):
            print("  " + "  ".join(f"{key} {_cell(value)}" for key, value in row.items() if key != "trace"))
        sys.stdout.flush()

    def _run(self, name: str, seconds: float) -> dict[str, Any]:
        with tempfile.TemporaryDirectory() as folder, (self._out / "log.txt").open("a") as log:
            rows = Path(folder) / "rows.jsonl"
            arguments = (name, self._scale, f"{seconds - 2.0:.1f}", str(rows))
            command = (sys.executable, "-m", f"{__package__}.phase", *arguments)
            print(f"== {name}", file=log, flush=True)
            try:
                done = run(command, timeout=seconds, env=self._environment, stdout=log, stderr=log)
            except subprocess.TimeoutExpired:
                ended = f"time limit of {seconds:.0f} s"
            else:
                ended = {0: "done", 1: "failed"}.get(done.returncode, f"exit code {done.returncode}")
            return {"ended": ended, "rows": read_lines(rows)}

    @property
    def ok(self) -> bool:
        """Whether no phase failed; a phase that ran out of time did not."""
        return all(found["ended"].startswith(("done", "skipped", "time")) for found in self.findings.values())


def _cell(value: Any) -> str:  # noqa: ANN401 - whatever JSON can hold
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main(argv: list[str] | None = None) -> int:
    """Run the check and return its exit code: 0 unless a phase failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.gpu", description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("findings"), help="folder of the findings")
    parser.add_argument("--minutes", type=float, default=15.0, help="time budget; later phases are skipped")
    parser.add_argument("--only", nargs="+", choices=list(PHASES), default=list(PHASES), metavar="PHASE")
    parser.add_argument("--small", action="store_true", help="in miniature, with devices that imitate a GPU")
    arguments = parser.parse_args(argv)
    arguments.out.mkdir(parents=True, exist_ok=True)
    scale, devices = ("small", {"DAPPO_GPU_SOFTWARE": "1"}) if arguments.small else ("full", vulkan_driver())
    check = Check(arguments.out, scale, devices, 60.0 * arguments.minutes)
    for name in arguments.only:
        check.phase(name, PHASES[name].seconds)
        if name == "machine" and not arguments.small and not check.ok:
            print("error: there is no GPU; --small runs without one", file=sys.stderr)
            return 1
    print(f"{'no phase failed' if check.ok else 'a phase failed'}; findings in {arguments.out}")
    return 0 if check.ok else 1


if __name__ == "__main__":
    sys.exit(main())
