"""The check of a machine with a GPU, in miniature on Warp's CPU device."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")

from dappo_batch import devices

from .__main__ import main

PHASES = ["machine", "graph", "physics", "decisions", "speed", "training", "tests"]


def findings(out: Path) -> dict[str, Any]:
    """Read the findings of a check."""
    found: dict[str, Any] = json.loads((out / "findings.json").read_text())
    assert list(found) == PHASES
    return found


def test_phases_for_which_no_time_is_left_are_reported_as_skipped(tmp_path: Path) -> None:
    assert main(["--device", "warp-cpu", "--out", str(tmp_path), "--minutes", "0"]) == 0
    assert findings(tmp_path) == {phase: {"skipped": "no time left"} for phase in PHASES}


def test_a_machine_without_a_gpu_is_an_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(devices, "_has_driver", lambda: False)
    assert main(["--out", str(tmp_path / "out")]) == 1
    assert "the device cuda cannot be used: there is no NVIDIA driver" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_every_phase_runs_in_miniature(tmp_path: Path) -> None:
    arguments = ["--device", "warp-cpu", "--out", str(tmp_path), "--minutes", "30"]
    assert main(arguments) == 0
    found = findings(tmp_path)
    assert found["graph"] == {"ok": True, "bit_equal": True, "differences": {}}
    assert found["decisions"]["same_episodes"] is True
    assert [row["num_envs"] for row in found["speed"]] == [2, 4]
    assert all(row["steps_per_second"] > 0 for row in found["speed"])
    assert (found["training"]["exit_code"], found["training"]["env_steps"]) == (0, 128)
    assert " passed" in found["tests"]["summary"]
