"""The check of a machine with a GPU, in miniature on devices that imitate one."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from dappo_batch import ConfigError
from dappo_batch._core import gpu_device

from .__main__ import main
from .phase import PHASES

ENGINE = ["agreement", "speed", "rollouts", "healthy_gpu", "dappo_gpu"]
WARP = ["warp_speed", "warp_correctness", "warp_tests"]


def findings(out: Path) -> dict[str, Any]:
    """Read the findings of a check."""
    found: dict[str, Any] = json.loads((out / "findings.json").read_text())
    return found


def check(out: Path, *phases: str) -> dict[str, list[dict[str, Any]]]:
    """Run phases, which must succeed; return their rows."""
    assert main(["--small", "--out", str(out), "--minutes", "30", "--only", *phases]) == 0
    found = findings(out)
    assert list(found) == list(phases)
    assert {phase["ended"] for phase in found.values()} == {"done"}
    return {name: phase["rows"] for name, phase in found.items()}


def test_phases_for_which_no_time_is_left_are_reported_as_skipped(tmp_path: Path) -> None:
    assert main(["--small", "--out", str(tmp_path), "--minutes", "0"]) == 0
    skipped = {"ended": "skipped: no time left", "seconds": 0.0}
    assert findings(tmp_path) == dict.fromkeys(PHASES, skipped)


@pytest.mark.slow
def test_the_lane_engine_is_timed_and_trains(tmp_path: Path) -> None:
    found = check(tmp_path, "lanes", "healthy_lanes", "dappo_lanes")
    assert [(row["num_envs"], row["lanes f32"] > 0) for row in found["lanes"]] == [(4, True)]
    for phase in ("healthy_lanes", "dappo_lanes"):
        assert [(row["exit_code"], row["env_steps"]) for row in found[phase]] == [(0, 128)]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["findings.json", "log.txt"]


@pytest.mark.slow
def test_the_gpu_engine_is_compared_timed_and_trains(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DAPPO_GPU_SOFTWARE", "1")
    try:
        gpu_device()
    except ConfigError as error:
        pytest.skip(str(error))
    found = check(tmp_path, "machine", *ENGINE)
    forces, tests = found["agreement"][:4], found["agreement"][4:]
    assert [row["precision"] for row in forces] == ["f32", "f64"] * 2
    assert [(row["tests"], " passed" in row["summary"]) for row in tests] == [
        ("physics", True),
        ("backend", True),
        ("rollouts", True),
    ]
    for phase in ("speed", "rollouts"):
        assert [row["num_envs"] for row in found[phase]] == [2, 4]
    for phase in ("healthy_gpu", "dappo_gpu"):
        assert [(row["exit_code"], row["env_steps"]) for row in found[phase]] == [(0, 128)]


@pytest.mark.slow
def test_mujoco_warp_is_compared_and_timed(tmp_path: Path) -> None:
    pytest.importorskip("warp", reason="needs the extra `gpu`: pip install dappo-batch[gpu]")
    found = check(tmp_path, *WARP)
    graph, _, decisions = found["warp_correctness"]
    assert graph == {"ok": True, "bit_equal": True, "differences": {}}
    assert decisions["same_episodes"] is True
    assert [row["num_envs"] for row in found["warp_speed"]] == [4]
    assert all(row["steps_per_second"] > 0 for row in found["warp_speed"])
    assert " passed" in found["warp_tests"][0]["summary"]
