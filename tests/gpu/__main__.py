"""``python -m tests.gpu``: correctness and speed of the GPU backend on this machine.

It needs the extra ``gpu`` and no network. Phases run in order; those for which no time is left are reported
as skipped. Findings are printed and written to ``findings.json``.
"""

from __future__ import annotations

import argparse
import json
import platform
import sys
import time
import traceback
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any

from dappo_batch import devices
from dappo_batch._core import ConfigError

from .scale import SCALES, Scale


class Check:
    """The findings so far, which are written to a file after every phase.

    Parameters
    ----------
    out : Path
        Folder of the findings.
    seconds : float
        Time budget of the whole check.
    """

    def __init__(self, out: Path, seconds: float) -> None:
        self.findings: dict[str, Any] = {}
        self._path = out / "findings.json"
        self._end = time.monotonic() + seconds

    @property
    def left(self) -> float:
        """Time left, s."""
        return self._end - time.monotonic()

    def phase(self, name: str, work: Callable[[], Any]) -> None:
        """Run a phase if there is time, and print its findings; exceptions are findings too."""
        start = time.monotonic()
        if self.left <= 0.0:
            found: Any = {"skipped": "no time left"}
        else:
            try:
                found = work()
            except Exception as error:
                # An exception in one phase must not stop the others.
                found = {"ok": False, "error": devices.explain(error), "trace": traceback.format_exc()}
        self.findings[name] = found
        self._path.write_text(json.dumps(self.findings, indent=2) + "\n")
        print(f"{name} ({time.monotonic() - start:.1f} s)")
        for line in _lines(found):
            print(f"  {line}")
        sys.stdout.flush()

    @property
    def ok(self) -> bool:
        """Whether no phase failed; skipped phases do not count as failed."""
        return all(found.get("ok", True) for found in self.findings.values() if isinstance(found, dict))


def _lines(found: Any) -> list[str]:  # noqa: ANN401 - whatever JSON can hold
    if isinstance(found, list):
        return [_cells(row) for row in found]
    return [f"{name}: {_cell(value)}" for name, value in found.items()]


def _cells(row: dict[str, Any]) -> str:
    return "  ".join(f"{name} {_cell(value)}" for name, value in row.items())


def _cell(value: Any) -> str:  # noqa: ANN401
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def machine(scale: Scale) -> dict[str, Any]:
    """Return versions, driver and device."""
    wp = devices.load_warp()
    device = wp.get_device(scale.device)
    packages = ("dappo-batch", "mujoco", "mujoco-warp", "warp-lang", "numpy")
    return {name: version(name) for name in packages} | {
        "python": platform.python_version(),
        "driver": wp.get_cuda_driver_version(),
        "toolkit": wp.get_cuda_toolkit_version(),
        "device": f"{device.alias} {device.name}",
        "memory_gib": round(device.total_memory / 2**30, 1) if device.is_cuda else None,
        "kernel_cache": wp.config.kernel_cache_dir,
    }


def main(argv: list[str] | None = None) -> int:
    """Run the check and return its exit code: 0 unless a phase failed."""
    parser = argparse.ArgumentParser(prog="python -m tests.gpu", description=__doc__)
    parser.add_argument("--device", choices=sorted(SCALES), default="cuda")
    parser.add_argument("--out", type=Path, default=Path("findings"), help="folder of the findings")
    parser.add_argument("--minutes", type=float, default=8.0, help="time budget; later phases are skipped")
    arguments = parser.parse_args(argv)
    device, scale = arguments.device, SCALES[arguments.device]
    try:
        devices.resolve(device)
    except ConfigError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    wp = devices.load_warp()

    from . import correctness, speed, training

    arguments.out.mkdir(parents=True, exist_ok=True)
    check = Check(arguments.out, 60.0 * arguments.minutes)
    with wp.ScopedDevice(scale.device):
        check.phase("machine", lambda: machine(scale))
        check.phase("graph", lambda: correctness.graph(scale))
        check.phase("physics", lambda: correctness.physics(scale))
        check.phase("decisions", lambda: correctness.decisions(device))
        # The training runs before the tests, which use the remaining time.
        reserved = 0.4 * check.left
        check.phase("speed", lambda: list(speed.speed(scale, lambda: check.left > reserved)))
        run = arguments.out / f"run-{time.time():.0f}"
        check.phase("training", lambda: training.training(scale, device, run, 0.7 * check.left))
        check.phase("tests", lambda: training.kernel_tests(scale, check.left))
    print(f"{'no phase failed' if check.ok else 'a phase failed'}; findings in {arguments.out}")
    return 0 if check.ok else 1


if __name__ == "__main__":
    sys.exit(main())
