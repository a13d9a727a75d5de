"""Run folders as NumPy arrays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

import dappo_batch
from dappo_batch import CheckpointError, ConfigError, Meta, load_run

from .command_line import ITERATION, TINY
from .command_line import dappo_batch as command
from .run_folders import write_adaptation, write_diagnoser, write_run


def test_a_run_is_its_files(tmp_path: Path) -> None:
    path = write_run(tmp_path / "run", seed=7, aware=False, encodings=["wrong"])
    write_adaptation(path)
    run = load_run(str(path))
    assert (run.path, run.robot, run.seed, run.observes_damage) == (path, "ant", 7, False)
    assert run.config["ppo"]["gamma"] == 0.99
    assert run.meta.mujoco == "4.0.0"
    assert run.metrics["env_steps"].dtype == np.int64
    np.testing.assert_array_equal(run.metrics["env_steps"], [100, 200, 300, 400])
    np.testing.assert_array_equal(run.metrics["forward_reward"], [1.0, np.nan, 3.0, 5.0])
    assert run.metrics["stage"].tolist() == ["all"] * 4
    assert list(run.per_class) == ["true", "wrong"]
    assert run.per_class["true"]["group"].tolist() == ["none", "D1", "D2", "D2"]
    np.testing.assert_array_equal(run.per_class["wrong"]["forward_reward"], [0.0, 1.0, 2.0, 3.0])
    assert run.groups == {}
    assert run.adaptation is not None
    assert np.isnan(run.adaptation["unaware"]).all(), "a column without entries"


def test_a_trained_run_can_be_read(tmp_path: Path) -> None:
    command("train", *TINY, "--steps", str(2 * ITERATION), "--run", tmp_path / "run")
    run = load_run(tmp_path / "run")
    np.testing.assert_array_equal(run.metrics["env_steps"], [ITERATION, 2 * ITERATION])
    assert run.per_class["true"]["name"][0] == "healthy"
    assert run.groups["true"]["group"][-1] == "all"
    assert run.metrics["backend"].tolist() == [run.meta.backend] * 2


def test_columns_that_newer_versions_write_are_empty_in_older_lines(tmp_path: Path) -> None:
    path = write_run(tmp_path / "run", forward_rewards=[1.0]) / "metrics.jsonl"
    with path.open("a") as file:
        file.write('{"iteration": 2, "env_steps": 200, "kl": 0.5, "backend": "lanes"}\n')
    metrics = load_run(tmp_path / "run").metrics
    np.testing.assert_array_equal(metrics["kl"], [np.nan, 0.5])
    np.testing.assert_array_equal(metrics["episodes"], [1.0, np.nan])
    assert metrics["backend"].tolist() == ["", "lanes"]


def test_columns_of_an_earlier_version_have_todays_names(tmp_path: Path) -> None:
    path = write_run(tmp_path / "run", forward_rewards=[1.0])
    (path / "eval").mkdir(exist_ok=True)
    earlier = (
        "class,name,episodes,ended_before,right_at_first,right_at_last,examinations,adapted,oracle,unadapted\n"
        "1,jammed_joint@0,10,1,8,9,1.25,60.0,80.0,50.0\n"
    )
    (path / "eval" / "adapt.csv").write_text(earlier)
    table = load_run(path).adaptation
    assert table is not None
    names = ("ended_before_onset", "correct_first", "correct_last", "diagnosis_windows", "no_adaptation")
    assert [table[name].tolist() for name in names] == [[1], [8], [9], [1.25], [50.0]]


def test_a_run_that_is_still_training_can_be_read(tmp_path: Path) -> None:
    path = write_run(tmp_path / "run", forward_rewards=[1.0, 2.0])
    with (path / "metrics.jsonl").open("a") as file:
        file.write('{"iteration": 3, "env_st')
    assert load_run(path).metrics["iteration"].tolist() == [1, 2]
    (path / "metrics.jsonl").unlink()
    (path / "meta.json").unlink()
    run = load_run(path)
    assert (dict(run.metrics), run.meta) == ({}, Meta())


def test_a_table_of_an_evaluation_without_rows_is_rejected(tmp_path: Path) -> None:
    path = write_run(tmp_path / "run", forward_rewards=[1.0])
    (path / "eval").mkdir(exist_ok=True)
    (path / "eval" / "per_class.csv").write_text("class,name,group,forward_reward\n")
    with pytest.raises(CheckpointError, match=r"per_class\.csv has no rows; run dappo-batch evaluate"):
        load_run(path)


def test_a_folder_that_is_not_a_run_folder_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="is not a folder; expected a run folder"):
        load_run(tmp_path / "nowhere")
    with pytest.raises(ConfigError, match=r"is not a run folder: it has no config\.toml"):
        load_run(tmp_path)
    with pytest.raises(ConfigError, match=r"its config\.toml has no robot, seed, total_steps, env, ppo"):
        load_run(write_diagnoser(tmp_path / "diagnoser"))


@pytest.mark.parametrize(
    ("file", "content", "message"),
    [
        ("config.toml", "robot = ", "config.toml cannot be read"),
        ("meta.json", "{", "meta.json cannot be read"),
        ("meta.json", "[]", "meta.json holds list, expected a JSON object"),
        ("meta.json", '{"mujoco": 4}', "meta.json: mujoco is 4, expected a value of type str"),
        ("meta.json", '{"threads": true}', "threads is True, expected a value of type int"),
        ("meta.json", '{"changes": [{"key": "a"}]}', "a change has no key, iteration or env_steps"),
        ("meta.json", '{"changes": 5}', "the changes must be a sequence"),
        ("metrics.jsonl", '{"a": 1}\n{"a"\n{"a": 2}\n', "metrics.jsonl, line 2"),
        ("metrics.jsonl", "[1]\n", r"line 1 is '\[1\]', expected a JSON object"),
        ("eval/per_class.csv", "", "per_class.csv is empty"),
        ("eval/per_class.csv", "class,name\n0,healthy\n", "has no column group, forward_reward"),
        (
            "eval/per_class.csv",
            "class,name,group,forward_reward\n0,healthy\n",
            "row 2 has 2 entries, expected 4",
        ),
    ],
)
def test_a_damaged_file_is_in_the_error(tmp_path: Path, file: str, content: str, message: str) -> None:
    path = write_run(tmp_path / "run")
    (path / file).write_text(content)
    with pytest.raises(CheckpointError, match=message):
        load_run(path)


def test_load_run_is_public() -> None:
    assert {"Run", "load_run"} <= set(dappo_batch.__all__)
