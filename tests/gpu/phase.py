"""``python -m tests.gpu.phase``: one phase of the check. Its findings are written to a file row by row."""

from __future__ import annotations

import json
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from dappo_batch import devices

from . import engine, machine
from .scale import FULL, SMALL, Scale
from .training import pytest_summary, training

__all__ = ["PHASES", "SCALES", "Phase", "main"]

SCALES = {"full": FULL, "small": SMALL}

_LANES = ("--device", "cpu", "--backend", "lanes")
_GPU = ("--device", "gpu")
_KERNEL_TESTS = Path(__file__).parent.parent / "kernels"
_MARGIN = 25.0
"""Time that a training takes to stop, s."""

Row = dict[str, Any]


@dataclass(frozen=True)
class Phase:
    """A phase: what yields its rows in at most so many seconds, and the most that it is given."""

    seconds: float
    rows: Callable[[Scale, float], Iterator[Row]]


def _healthy(device: tuple[str, ...]) -> Callable[[Scale, float], Iterator[Row]]:
    def rows(scale: Scale, seconds: float) -> Iterator[Row]:
        yield training((*scale.healthy, *device), scale.forward_reward, seconds - _MARGIN)

    return rows


def _dappo(device: tuple[str, ...]) -> Callable[[Scale, float], Iterator[Row]]:
    def rows(scale: Scale, seconds: float) -> Iterator[Row]:
        yield training((*scale.dappo, *device), float("inf"), seconds - _MARGIN)

    return rows


def _on_warp(work: Callable[[Scale], Iterator[Row]]) -> Callable[[Scale, float], Iterator[Row]]:
    """Return a phase of mujoco_warp, whose modules are imported only here: they belong to an extra."""

    def rows(scale: Scale, _: float) -> Iterator[Row]:
        devices.resolve(scale.warp[0])
        wp = devices.load_warp()
        with wp.ScopedDevice(scale.warp[1]):
            yield from work(scale)

    return rows


def _warp_speed(scale: Scale) -> Iterator[Row]:
    from .speed import speed

    yield from speed(scale)


def _warp_correctness(scale: Scale) -> Iterator[Row]:
    from . import correctness

    yield correctness.graph(scale)
    yield correctness.physics(scale)
    yield correctness.decisions(scale.warp[0])


def _kernel_tests(scale: Scale, seconds: float) -> Iterator[Row]:
    environment = {"DAPPO_WARP_DEVICE": scale.warp[1]}
    yield pytest_summary([str(_KERNEL_TESTS)], scale.tests, environment, seconds - 5.0)


PHASES = {
    "machine": Phase(60.0, lambda _scale, _seconds: machine.describe()),
    "lanes": Phase(60.0, engine.lanes),
    "agreement": Phase(120.0, engine.agreement),
    "speed": Phase(120.0, engine.speed),
    "rollouts": Phase(120.0, engine.rollouts),
    "healthy_gpu": Phase(100.0, _healthy(_GPU)),
    "healthy_lanes": Phase(70.0, _healthy(_LANES)),
    "dappo_gpu": Phase(150.0, _dappo(_GPU)),
    "dappo_gpu_learner": Phase(100.0, _dappo((*_GPU, "--learner", "gpu"))),
    "dappo_lanes": Phase(100.0, _dappo(_LANES)),
    "warp_speed": Phase(200.0, _on_warp(_warp_speed)),
    "warp_correctness": Phase(120.0, _on_warp(_warp_correctness)),
    "warp_tests": Phase(300.0, _kernel_tests),
}
"""All phases in the order in which they run: what matters most comes first."""


def main(argv: list[str]) -> int:
    """Run a phase: its name, a scale, seconds, and the file for its rows; return 1 if it failed."""
    name, scale, seconds, path = argv
    ok = True
    with Path(path).open("w") as file:

        def write(row: Row) -> None:
            file.write(json.dumps(row) + "\n")
            file.flush()

        try:
            for row in PHASES[name].rows(SCALES[scale], float(seconds)):
                ok = ok and row.get("ok", True)
                write(row)
        except Exception as error:
            # An exception is a finding.
            ok = False
            write({"ok": False, "error": devices.explain(error), "trace": traceback.format_exc()})
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
