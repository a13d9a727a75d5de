"""Runs, diagnosers and exports of earlier versions are read; those in `earlier/` were made by one.

They are of an Ant with jammed joints, a policy of two hidden units, and a diagnoser of three steps.
"""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import dappo_batch
from dappo_batch import Controller, Policy

from .command_line import dappo_batch as command_line
from .command_line import files, metrics

EARLIER = Path(__file__).parent / "earlier"
STEPS = 16


def test_the_policy_of_a_run_acts_as_in_its_export() -> None:
    run, export = Policy.load(EARLIER / "run"), Policy.from_export(EARLIER / "export")
    obs = np.random.default_rng(0).normal(size=(10, run.obs_dim)).astype("f4")
    classes = np.arange(10) % len(run.class_names)
    np.testing.assert_array_equal(run.act(obs, damage_class=classes), export.act(obs, damage_class=classes))


def test_a_run_of_an_earlier_version_resumes(tmp_path: Path) -> None:
    shutil.copytree(EARLIER / "run", tmp_path / "run")
    assert (tmp_path / "run" / "checkpoints" / "00000002" / "envs.bin").exists()
    dappo_batch.resume(tmp_path / "run", total_steps=4 * STEPS, threads=1)
    # The whole of it at once.
    command_line(
        *("train", "--config", EARLIER / "run" / "config.toml", "--threads", "1"),
        # The earlier version had no symmetric networks, which the preset of this one chooses.
        *("--steps", str(4 * STEPS), "--run", tmp_path / "whole", "--set", "ppo.symmetry=false"),
    )
    # Processors differ in their last digits.
    for resumed, whole in zip(metrics(tmp_path / "run"), metrics(tmp_path / "whole"), strict=True):
        # The earlier version had fewer metrics.
        assert resumed.keys() <= whole.keys()
        for key, value in resumed.items():
            if isinstance(value, float):
                # The velocities of a robot that hardly moves cancel in the sum over an episode.
                least = 1e-3 if key == "forward_reward" else None
                assert value == pytest.approx(whole[key], rel=1e-3, abs=least), key
    with (tmp_path / "run" / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [int(row["iteration"]) for row in rows] == [
        line["iteration"] for line in metrics(tmp_path / "run")
    ]


def test_an_export_of_the_run_and_the_diagnoser_is_that_of_the_earlier_version(tmp_path: Path) -> None:
    run, out = tmp_path / "run", tmp_path / "export"
    shutil.copytree(EARLIER / "run", run)
    command = ("export", run, "--diagnoser", EARLIER / "diagnoser", "--out", out)
    _, err = command_line(*command, code=1)
    assert f"`dappo-batch evaluate {run}` writes it" in err
    # What an evaluation would write, with the digits of the earlier table.
    with (run / "eval" / "per_class.csv").open(newline="") as file:
        velocities = {
            row["name"]: round(float(row["forward_reward"]) / float(row["episode_length"]), 6)
            for row in csv.DictReader(file)
        }
    classes = [{"name": name, "forward_velocity": velocity} for name, velocity in velocities.items()]
    (run / "eval" / "evaluation.json").write_text(json.dumps({"classes": classes}))
    command_line(*command)
    found, earlier = files(out), files(EARLIER / "export")
    header, earlier_header = (json.loads(export.pop("export.json")) for export in (found, earlier))
    # What later versions added.
    for line in (b'schedule = "constant"\n', b"symmetry = false\n"):
        found["config.toml"] = found["config.toml"].replace(line, b"")
    assert found == earlier
    header["files"]["config.toml"] = earlier_header["files"]["config.toml"]
    assert len(header.pop("observation")) == header["obs_dim"]
    assert len(header.pop("joints")) == header["action_dim"]
    for key in ("diagnose_every", "agreement"):
        header["controller"].pop(key)
    assert header == earlier_header
    assert Controller.from_export(EARLIER / "export").class_names[0] == "healthy"
