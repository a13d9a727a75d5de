"""The commands as functions: they do what the command line does, and stop and fail as a program expects."""

from __future__ import annotations

import csv
import json
import shutil
import signal
import sys
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dappo_batch
from dappo_batch import Change, ConfigError, EvaluationReport, SimulationError, TrainingOptions

from .. import processes
from .command_line import ITERATION, TINY, files, metrics
from .command_line import dappo_batch as command_line

OPTIONS: TrainingOptions = {
    "threads": 1,
    "num_envs": 4,
    "set": {
        "horizon": 16,
        "env": {"max_episode_steps": 20},
        "ppo.hidden": [8],
        "ppo.schedule": "constant",
        "evaluation.episodes": 1,
        "damage.max_damaged_limbs": 1,
        "checkpoint.every": 3,
    },
}
"""`TINY` in Python."""


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train by the command line for three iterations."""
    run = tmp_path_factory.mktemp("commands") / "run"
    command_line("train", "--run", run, "--steps", str(3 * ITERATION), *TINY)
    return run


def test_a_training_equals_that_of_the_command_line_and_passes_metrics_to_the_callback(
    tmp_path: Path, run: Path
) -> None:
    lines: list[dict[str, Any]] = []
    trained = dappo_batch.train(tmp_path / "run", total_steps=3 * ITERATION, callback=lines.append, **OPTIONS)
    assert metrics(tmp_path / "run") == metrics(run)
    assert [line["env_steps"] for line in lines] == [ITERATION, 2 * ITERATION, 3 * ITERATION]
    assert trained.metrics["kl"].tolist() == [line["kl"] for line in lines]
    with (run / "eval" / "per_class.csv").open(newline="") as file:
        expected = [float(row["forward_reward"]) for row in csv.DictReader(file)]
    assert trained.per_class["true"]["forward_reward"].tolist() == expected


def test_a_training_stopped_by_a_callback_resumes_bit_identically(tmp_path: Path, run: Path) -> None:
    stopped = dappo_batch.train(
        tmp_path / "run", total_steps=3 * ITERATION, callback=lambda line: line["iteration"] < 2, **OPTIONS
    )
    assert stopped.metrics["iteration"].tolist() == [1, 2]
    assert not stopped.per_class
    resumed = dappo_batch.resume(tmp_path / "run")
    assert metrics(tmp_path / "run") == metrics(run)
    assert len(resumed.per_class["true"]["name"]) == 9


def test_settings_can_change_when_a_run_is_resumed_and_the_folder_records_them(
    tmp_path: Path, run: Path
) -> None:
    copy = tmp_path / "run"
    shutil.copytree(run, copy)
    resumed = dappo_batch.resume(
        copy, total_steps=4 * ITERATION, set={"ppo": {"learning_rate": 1e-5}, "checkpoint.every": 1}
    )
    # The adaptive factor lies between 0.1 and 10.
    assert resumed.metrics["learning_rate"][2] > 1e-4 > resumed.metrics["learning_rate"][3]
    assert (resumed.config["ppo"]["learning_rate"], resumed.config["total_steps"]) == (1e-5, 4 * ITERATION)
    where = {"iteration": 3, "env_steps": 3 * ITERATION}
    rate = dappo_batch.load_run(run).config["ppo"]["learning_rate"]
    assert resumed.meta.changes == (
        Change("checkpoint.every", 3, 1, **where),
        Change("ppo.learning_rate", rate, 1e-5, **where),
        Change("total_steps", 3 * ITERATION, 4 * ITERATION, **where),
    )


def test_an_explicit_setting_wins_over_the_flag_of_the_same_name_in_new_and_resumed_runs(
    tmp_path: Path, run: Path
) -> None:
    copy = tmp_path / "run"
    shutil.copytree(run, copy)
    flags = ("--steps", str(5 * ITERATION), "--threads", "2", "--json")
    settings = ("--set", f"total_steps={4 * ITERATION}", "env.threads=1")
    command_line("train", "--resume", copy, *flags, *settings)
    out, _ = command_line("config", *flags[:-1], *settings)
    for config in (dappo_batch.load_run(copy).config, tomllib.loads(out)):
        assert (config["total_steps"], config["env"]["threads"]) == (4 * ITERATION, 1)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ({"ppo.hidden": [16]}, r"`ppo.hidden` cannot change in a run, from \[8\] to \[16\]: its networks"),
        ({"env": {"num_envs": 8}}, "`env.num_envs` cannot change in a run, from 4 to 8"),
        ({"robot": "hexapod"}, "`robot` cannot change"),
        ({"ppo.preset": "batch"}, "`ppo.preset` cannot change"),
        ({"ppo.learning_rate": -1}, "`ppo.learning_rate` is -1"),
    ],
)
def test_settings_that_checkpoints_depend_on_are_rejected_and_the_run_is_unchanged(
    run: Path, setting: dict[str, Any], message: str
) -> None:
    before = files(run)
    with pytest.raises(ConfigError, match=message):
        dappo_batch.resume(run, set=setting)
    assert files(run) == before


def test_a_diverged_training_resumes_with_lower_learning_rates(tmp_path: Path) -> None:
    # One step takes a policy that hardly varies so far that the square of its KL overflows.
    huge = {"ppo.initial_log_variance": -40, "ppo.kl_hinge": 1e9, "ppo.learning_rate": 1.0}
    settings = {**OPTIONS["set"], **huge, "ppo.minibatch_size": 16}
    options: TrainingOptions = {**OPTIONS, "set": settings}
    with pytest.raises(
        SimulationError, match=r"the training has diverged: in iteration \d the policy loss"
    ) as raised:
        dappo_batch.train(tmp_path / "run", total_steps=3 * ITERATION, **options)
    assert f"train --resume {tmp_path / 'run'} --set ppo.learning_rate=" in str(raised.value)
    with pytest.raises(SimulationError, match=r"in iteration \d the"):
        dappo_batch.resume(tmp_path / "run")
    resumed = dappo_batch.resume(tmp_path / "run", set={"ppo.learning_rate": 1e-12})
    assert np.isfinite(resumed.metrics["policy_loss"]).tolist() == [True] * 3
    assert resumed.meta.changes == (Change("ppo.learning_rate", 1.0, 1e-12, iteration=0, env_steps=0),)


def test_exceptions_of_a_callback_are_raised_and_the_run_can_be_resumed(tmp_path: Path) -> None:
    def fail(_: dict[str, Any]) -> None:
        raise LookupError("of the callback")

    with pytest.raises(LookupError, match="of the callback"):
        dappo_batch.train(tmp_path / "run", total_steps=40 * ITERATION, callback=fail, **OPTIONS)
    assert 0 < len(dappo_batch.load_run(tmp_path / "run").metrics["iteration"]) < 40


def test_ctrl_c_stops_gracefully_and_pythons_handler_is_restored(tmp_path: Path) -> None:
    program = """
import sys, dappo_batch
options = {"threads": 1, "num_envs": 4, "set": {"horizon": 16, "ppo.hidden": [8]}}
try:
    say = lambda line: print("line", flush=True)
    dappo_batch.train(sys.argv[1], total_steps=10**9, callback=say, **options)
except KeyboardInterrupt:
    try:
        print("interrupted", flush=True)
        while True:
            pass
    except KeyboardInterrupt:
        print("again", flush=True)
"""
    command = [sys.executable, "-c", program, str(tmp_path / "run")]
    with processes.start(command) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "line\n"
        process.send_signal(signal.SIGINT)
        while (line := process.stdout.readline()) == "line\n":
            pass
        assert line == "interrupted\n"
        process.send_signal(signal.SIGINT)
        assert process.stdout.readline() == "again\n"
        assert process.wait(timeout=60) == 0
    saved = sorted((tmp_path / "run" / "checkpoints").iterdir())[-1].name
    assert int(saved) == dappo_batch.load_run(tmp_path / "run").metrics["iteration"][-1]


def test_an_evaluation_returns_what_the_command_line_prints(run: Path) -> None:
    out, _ = command_line("evaluate", run, "--episodes", "1", "--json", "--threads", "1")
    report = dappo_batch.evaluate(run, episodes=1, threads=1)
    assert report.to_dict() == json.loads(out)
    assert EvaluationReport.from_dict(report.to_dict()) == report
    assert isinstance(hash(report), int), "a result is frozen"


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"envz": 4}, "there is no argument `envz`; expected one of .*num_envs"),
        ({"num_envs": 0}, "num_envs must be at least 1, got 0"),
        ({"num_envs": "4"}, "num_envs must be an integer, got '4'"),
        ({"num_envs": 4.0}, "num_envs must be an integer, got 4.0"),
        ({"seed": -1}, "seed must be at least 0, got -1"),
        ({"threads": 10**9}, "threads must be at most [0-9]+, got 1000000000"),
        ({"device": "tpu"}, "device must be one of 'auto', 'cpu', 'gpu', 'cuda', 'warp-cpu', got 'tpu'"),
        ({"unaware": 1}, "unaware must be True or False, got 1"),
        ({"reward": 3}, "reward must be a text, got 3"),
        ({"config": "\0"}, "config must be a path"),
        ({"set": ["seed=1"]}, "set must be a mapping"),
        ({"set": {"seed": object()}}, "seed must be a value that TOML has"),
        ({"set": {"seed": 2**63}}, "seed must be between"),
        (
            {"resume": "run"},
            "cannot be used together with (resume|run)",
        ),
        ({"robot_changed": "use-run"}, "robot_changed cannot be used without resume"),
        ({"json": False}, "there is no argument `json`"),
        ({"set": {"ppo.gama": 0.9}}, "did you mean `ppo.gamma`"),
        ({"robot": "spider"}, "spider"),
    ],
)
def test_bad_options_raise_and_leave_nothing_behind(
    tmp_path: Path, options: dict[str, Any], message: str
) -> None:
    with pytest.raises(ConfigError, match=message):
        dappo_batch.train(tmp_path / "run", **options)
    assert not (tmp_path / "run").exists()


def test_settings_have_the_values_of_python(tmp_path: Path) -> None:
    settings = {
        "ppo": {"hidden": np.array([8, 4]), "gamma": np.float32(0.5)},
        "curriculum": [{"name": 'é"\n', "mix": "healthy"}],
        "env.max_episode_steps": np.int64(20),
        "evaluation.episodes": 1,
        "horizon": 16,
    }
    run = dappo_batch.train(
        tmp_path / "run", num_envs=np.int32(4), threads=1, total_steps=ITERATION, set=settings
    )
    assert (run.config["ppo"]["hidden"], run.config["ppo"]["gamma"]) == ([8, 4], 0.5)
    assert run.config["curriculum"][0]["name"] == 'é"\n'
    assert run.meta.command[0].startswith("dappo_batch.train(run=PosixPath(")


def test_a_mean_reward_of_a_diagnosis_needs_a_policy(run: Path) -> None:
    with pytest.raises(ConfigError, match="also pass its run folder as policy"):
        dappo_batch.evaluate_diagnoser(run, data=[run], episodes=3)
    with pytest.raises(ConfigError, match="models must have at least one entry"):
        dappo_batch.evaluate_diagnoser(data=[run])
    with pytest.raises(ConfigError, match="log cannot be used together with all_classes"):
        dappo_batch.adapt(run, run, log="log.csv")


def test_from_pairs_to_a_diagnoser(tmp_path: Path, run: Path) -> None:
    paper: dict[str, Any] = {"preset": "paper", "timesteps": 4, "threads": 1}
    files = dappo_batch.collect_pairs(run, tmp_path / "pairs", rollouts=6, **paper)
    records = np.load(files[0], mmap_mode="r")
    assert records["damaged"].shape[:3] == (6, 9, 4)
    lines: list[dict[str, Any]] = []
    out = tmp_path / "diagnoser"
    epochs = dappo_batch.train_diagnoser(
        tmp_path / "pairs", out, method="A", set={"epochs": 2}, threads=1, callback=lines.append
    )
    assert [epoch.to_dict() for epoch in epochs] == lines
    lines = [json.loads(line) for line in (out / "metrics.jsonl").read_text().splitlines()]
    assert [line["train_loss"] for line in lines] == [epoch.train_loss for epoch in epochs]
    dappo_batch.collect_pairs(run, tmp_path / "test", rollouts=2, seed=7, **paper)
    (tested,) = dappo_batch.evaluate_diagnoser(out, data=[tmp_path / "test"], threads=1)
    assert tested.summary.windows == 2 * 9
    assert len(tested.class_accuracy) == len(tested.classes) == 9
    out, _ = command_line("diagnose", "test", tmp_path / "diagnoser", "--data", tmp_path / "test", "--json")
    assert [tested.to_dict()] == json.loads(out)


@pytest.mark.parametrize(("old", "new"), [("envs", "num_envs"), ("steps", "total_steps")])
def test_old_names_of_options_still_work_with_a_warning(old: str, new: str, tmp_path: Path) -> None:
    with (
        pytest.warns(FutureWarning, match=f"the option {old} is called {new} now") as warned,
        pytest.raises(ConfigError, match=f"{new} must be at least 1"),
    ):
        dappo_batch.train(tmp_path / "run", **{old: 0})  # type: ignore[arg-type]
    assert [warning.filename for warning in warned] == [__file__]
    with pytest.raises(ConfigError, match=f"{new} is given twice, also by its old name {old}"):
        dappo_batch.train(tmp_path / "run", **{old: 1, new: 1})  # type: ignore[arg-type]


def test_the_old_name_of_a_budget_still_works_when_a_run_is_resumed(run: Path, tmp_path: Path) -> None:
    copy = tmp_path / "run"
    shutil.copytree(run, copy)
    with pytest.warns(FutureWarning, match="the option steps is called total_steps now"):
        resumed = dappo_batch.resume(copy, steps=4 * ITERATION)
    assert resumed.config["total_steps"] == 4 * ITERATION
    with pytest.raises(ConfigError, match="total_steps is given twice"):
        dappo_batch.resume(copy, steps=4 * ITERATION, total_steps=5 * ITERATION)
