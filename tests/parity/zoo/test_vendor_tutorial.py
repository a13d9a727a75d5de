"""The tutorial of a vendor's robot, with the vendor's files and short trainings."""

from __future__ import annotations

import json
import shutil
from typing import TYPE_CHECKING

import dappo_batch

from ...python.pages import ROOT, blocks, run_line, shrunk
from .vendors import ROBOTS

if TYPE_CHECKING:
    from pathlib import Path

FOLDER = "unitree_go1"


def test_the_files_and_commands_of_the_tutorial_work_on_the_vendors_robot(
    wheels: Path, tmp_path: Path
) -> None:
    shutil.copytree(wheels / ROBOTS["go1_menagerie"], tmp_path / FOLDER)
    for block in blocks(ROOT / "docs" / "vendor-robot.md"):
        if block.file is not None:
            folder = tmp_path / FOLDER if block.file == "robot.toml" else tmp_path
            (folder / block.file).write_text(block.text, encoding="utf-8")
        elif block.language == "sh":
            for line in block.text.splitlines():
                if "render" not in line:
                    # A window of the diagnoser has 50 steps.
                    run_line(shrunk(line).replace("max_episode_steps=20", "max_episode_steps=120"), tmp_path)
    report = dappo_batch.check_robot(tmp_path / FOLDER / "robot.toml")
    assert report.backend == "lanes"
    assert len(report.damage_classes) == 9
    header = json.loads((tmp_path / "runs/robot/export.json").read_text())
    assert [entry["name"] for entry in header["joints"]][:3] == [
        "FR_hip_joint",
        "FR_thigh_joint",
        "FR_calf_joint",
    ]
    assert (tmp_path / "runs/go1/eval/adapt.csv").is_file()
