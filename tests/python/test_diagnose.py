"""`dappo-batch diagnose train`, `test` and `sweep`: the network that classifies the damage."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from .command_line import ITERATION, TINY, dappo_batch, dappo_batch_many, files, interrupt_when, read_lines

CLASSES = 9
SMALL = ("--set", "embedding=16", "lstm=8", "hidden=[16]", "minibatch_size=16")
Row = dict[str, str]


def read(path: Path) -> list[Row]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train two policies for a moment, collect pairs of two kinds, and train two networks."""
    root = tmp_path_factory.mktemp("diagnose")
    done = dappo_batch_many(
        ("train", *TINY, "--healthy", "--steps", str(ITERATION), "--run", root / "expert"),
        ("train", *TINY, "--steps", str(ITERATION), "--run", root / "aware"),
        collect(root, "paper", 60, 0),
        collect(root, "paper_test", 20, 1),
        collect(root, "residual_test", 20, 1, "--preset", "residual"),
        ("diagnose", "train", root / "paper", "--out", root / "a", "--method", "A", *SMALL, "epochs=6"),
        ("diagnose", "train", root / "paper", "--out", root / "b", *SMALL, "epochs=6", "--json"),
    )
    assert [code for code, _, _ in done] == [0] * len(done), done
    (root / "b.json").write_text(done[-1][1])
    return root


def collect(root: Path, name: str, rollouts: int, seed: int, *more: str) -> tuple[str | Path, ...]:
    sizes = ("--rollouts", str(rollouts), "--timesteps", "12", "--seed", str(seed))
    preset = () if "--preset" in more else ("--preset", "paper")
    return ("diagnose", "collect", root / "expert", "--out", root / name, *sizes, *preset, *more)


def matrix(path: Path) -> np.ndarray[Any, np.dtype[np.int64]]:
    """Read a confusion matrix: a row a true class, a column a diagnosed class."""
    rows = read(path)
    return np.array([[int(value) for key, value in row.items() if key != r"true\diagnosed"] for row in rows])


def test_a_training_leaves_its_settings_metrics_model_and_results(folder: Path) -> None:
    run = folder / "b"
    names = {str(path.relative_to(run)) for path in run.rglob("*") if path.is_file()}
    assert {"config.toml", "metrics.jsonl", "model/diagnoser.toml", "model/weights.bpk"} <= names
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert [line["epoch"] for line in lines] == list(range(1, len(lines) + 1))
    assert lines[-1]["samples"] == len(lines) * 48 * CLASSES, "a fifth of the rollouts validates"
    # What was printed is what was written.
    printed = (folder / "b.json").read_text()
    assert [line["validation_loss"] for line in read_lines(printed)] == [
        line["validation_loss"] for line in lines
    ]
    counts = matrix(run / "eval" / "validation.confusion.csv")
    assert counts.sum() == 12 * CLASSES
    best = min(lines, key=lambda line: line["validation_loss"])
    assert np.trace(counts) / counts.sum() == pytest.approx(best["validation_accuracy"])


def test_a_network_classifies_the_damage_of_unseen_rollouts_better_than_chance(folder: Path) -> None:
    out, _ = dappo_batch("diagnose", "test", folder / "b", "--data", folder / "paper_test", "--json")
    (tested,) = json.loads(out)
    summary = tested["summary"]
    counts = matrix(folder / "b" / "eval" / "paper_test.confusion.csv")
    assert summary["windows"] == counts.sum() == 20 * CLASSES
    assert summary["accuracy"] == pytest.approx(np.trace(counts) / counts.sum())
    assert summary["accuracy"] > 3 / CLASSES
    by_class = np.diag(counts) / counts.sum(1)
    np.testing.assert_allclose(tested["class_accuracy"], by_class)
    rows = read(folder / "b" / "eval" / "paper_test.classes.csv")
    assert [row["name"] for row in rows] == tested["classes"]
    np.testing.assert_allclose([float(row["accuracy"]) for row in rows], by_class, atol=5e-5)
    bins = read(folder / "b" / "eval" / "paper_test.calibration.csv")
    assert sum(int(row["count"]) for row in bins) == summary["windows"]


def test_several_networks_and_datasets_make_a_cross_table(folder: Path) -> None:
    models, data = (folder / "a", folder / "b"), (folder / "paper_test", folder / "residual_test")
    out, _ = dappo_batch("diagnose", "test", *models, "--data", *data, "--json")
    tested = json.loads(out)
    pairs = [(str(model), str(name)) for model in models for name in data]
    assert [(entry["model"], entry["data"]) for entry in tested] == pairs
    text, _ = dappo_batch("diagnose", "test", *models, "--data", *data)
    for entry in tested:
        assert f"{100 * entry['summary']['accuracy']:.2f}" in text


def test_the_cost_of_misclassifications_is_the_reward_of_a_policy_that_receives_them(folder: Path) -> None:
    command = ("test", folder / "b", "--data", folder / "paper_test", "--policy", folder / "aware")
    out, _ = dappo_batch("diagnose", *command, "--episodes", "2", "--json")
    (tested,) = json.loads(out)
    cost = tested["cost"]
    # With the true code, the forward reward is that of an evaluation.
    out, _ = dappo_batch("evaluate", folder / "aware", "--episodes", "2", "--json")
    groups = json.loads(out)["runs"][0]["groups"]
    (everything,) = [group for group in groups if group["group"] == "all"]
    assert cost["compared_by"] == "forward_reward"
    assert cost["true_score"] == pytest.approx(everything["forward_reward"], abs=1e-3)
    counts = matrix(folder / "b" / "eval" / "paper_test.confusion.csv")
    names = tested["classes"]
    shares = counts / counts.sum(1, keepdims=True)
    lost = 0.0
    for mistake in cost["mistakes"]:
        share = shares[names.index(mistake["class"]), names.index(mistake["diagnosed"])]
        assert mistake["share"] == pytest.approx(share)
        lost += share * (mistake["true_score"] - mistake["mistaken_score"])
    assert len(cost["mistakes"]) == np.count_nonzero(counts - np.diag(np.diag(counts)))
    assert cost["diagnosed_score"] == pytest.approx(cost["true_score"] - lost / CLASSES)
    ratio = cost["diagnosed_score"] / cost["true_score"]
    assert cost["gait_equivalent_accuracy"] == pytest.approx(ratio)


@pytest.mark.parametrize("head", ["classes", "limbs"])
def test_classes_that_are_held_out_are_tested_but_never_trained_on(
    head: str, folder: Path, tmp_path: Path
) -> None:
    held = ["missing_toe@1", "missing_toe@3"]
    names = ("--held-out", ",".join(held), "--head", head)
    run, data = tmp_path / "run", folder / "paper_test"
    dappo_batch("diagnose", "train", folder / "paper", *names, *SMALL, "epochs=2", "--out", run)
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    assert lines[-1]["samples"] == 2 * 48 * (CLASSES - 2)
    out, _ = dappo_batch("diagnose", "test", run, "--data", data, "--json")
    (tested,) = json.loads(out)
    counts = matrix(run / "eval" / "paper_test.confusion.csv")
    unseen = [tested["classes"].index(name) for name in held]
    accuracy = counts[unseen, unseen].sum() / counts[unseen].sum()
    assert tested["summary"]["held_out_accuracy"] == pytest.approx(accuracy)
    rows = read(run / "eval" / "paper_test.classes.csv")
    assert [row["name"] for row in rows if row["held_out"] == "true"] == held
    assert counts.sum(1).tolist() == [20] * CLASSES


def test_ctrl_c_and_resume_lead_to_the_same_epochs(folder: Path, tmp_path: Path) -> None:
    common = ("diagnose", "train", folder / "paper")
    whole, halves = tmp_path / "whole", tmp_path / "halves"
    settings = (*SMALL, "epochs=30", "patience=30", "dropout=0.2")
    dappo_batch(*common, "--out", whole, *settings)
    begun = (halves / "metrics.jsonl").exists
    err = interrupt_when(begun, *common, "--out", halves, *settings)
    assert "--resume" in err
    dappo_batch(*common, "--resume", halves)

    def epochs(run: Path) -> list[dict[str, Any]]:
        keys = ("epoch", "train_loss", "validation_loss", "validation_accuracy")
        lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
        return [{key: line[key] for key in keys} for line in lines]

    assert epochs(halves) == epochs(whole)
    assert len(epochs(whole)) == 30
    for name in ("confusion", "classes", "calibration"):
        path = Path("eval") / f"validation.{name}.csv"
        assert (halves / path).read_bytes() == (whole / path).read_bytes()


def test_bad_input_is_rejected_with_a_remedy(folder: Path, tmp_path: Path) -> None:
    train = ("diagnose", "train", folder / "paper", "--out", tmp_path / "out")
    test = ("diagnose", "test", folder / "b", "--data")
    expected: dict[tuple[str | Path, ...], tuple[int, str]] = {
        (*train, "--timesteps", "13"): (1, "the windows of the data have 12"),
        (*train, "--rollouts", "61"): (1, "expected 2 to 60"),
        (*train, "--held-out", "missing_toe@7"): (1, "`missing_toe@7` is not a damage class"),
        (*train, "--set", "epoch=3"): (1, "did you mean `epochs`"),
        (*train, "--set", "dropout=1"): (1, "`dropout` is 1, expected a number in [0, 1)"),
        (*train, "--method", "E"): (2, "A, B, C, D"),
        ("diagnose", "train", folder / "expert", "--out", tmp_path / "out"): (1, "dataset.json"),
        ("diagnose", "train", folder / "paper"): (2, "--out"),
        ("diagnose", "train", folder / "paper", "--out", folder / "a"): (1, "already holds"),
        (*test, folder / "expert"): (1, "`dappo-batch diagnose collect` makes such a folder"),
        (*test, folder / "paper_test", "--episodes", "2"): (2, "--policy"),
        ("diagnose", "test", folder / "expert", "--data", folder / "paper_test"): (1, "config.toml"),
    }
    done = dappo_batch_many(*expected)
    for (code, _, err), (command, (expected_code, message)) in zip(done, expected.items(), strict=True):
        assert code == expected_code, (command, err)
        assert message in err, (command, err)
    assert not (tmp_path / "out").exists()


def sweep(folder: Path, out: Path, *more: str) -> tuple[str | Path, ...]:
    axes = ("--rollouts", "6,10", "--timesteps", "4,12", "--test-rollouts", "5")
    return ("diagnose", "sweep", "--expert", folder / "expert", "--out", out, *axes, *more)


def test_a_sweep_fills_its_table_cell_by_cell_and_is_continued(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    settings = ("--samples", "300", *SMALL)
    dappo_batch(*sweep(folder, out, "--seeds", "1", *settings, "--jobs", "1"))
    before = files(out / "cells")
    # What a kill leaves that comes between the result of a cell and the end of its checkpoints.
    for name in ("T4-A-6-seed0/checkpoints", "T4-B-6-seed0/.checkpoints.0123456789abcdef.tmp"):
        (out / "cells" / name / "00000001").mkdir(parents=True)
        (out / "cells" / name / "00000001" / "net.bpk").write_text("left over")
    text, err = dappo_batch(*sweep(folder, out, "--seeds", "3", *settings))
    assert not list((out / "cells").glob("*/*checkpoints*"))
    assert {name: data for name, data in files(out / "cells").items() if name in before} == before
    assert err.count(" %)") == 2 * 2 * 2 * 3, "every cell is reported"
    results = [json.loads(path.read_text()) for path in sorted((out / "cells").glob("*/result.json"))]
    assert len(results) == 2 * 2 * 2 * 3
    kept = {(cell / "robot" / "robot.json").read_bytes() for cell in (out / "cells").iterdir()}
    assert kept == {(out / "pairs" / "robot" / "robot.json").read_bytes()}
    rows = read(out / "table1.csv")
    assert len(rows) == 2 * 2 * 2
    for row in rows:
        cell = {"timesteps": int(row["timesteps"]), "method": row["method"], "rollouts": int(row["rollouts"])}
        accuracies = [
            100 * result["accuracy"] for result in results if cell.items() <= result["cell"].items()
        ]
        assert int(row["seeds"]) == len(accuracies) == 3
        assert float(row["accuracy_pct"]) == pytest.approx(np.mean(accuracies), abs=0.006)
        assert float(row["sd_pct"]) == pytest.approx(np.std(accuracies, ddof=1), abs=0.006)
        assert row["paper_accuracy_pct"] == "", "the paper has no such cell"
        assert f"{float(row['accuracy_pct']):.2f} ± {float(row['sd_pct']):.2f}" in text
    # Cells side by side are the cells one after the other.
    alone = tmp_path / "alone"
    dappo_batch(*sweep(folder, alone, "--seeds", "3", *settings, "--jobs", "1"))
    assert (alone / "table1.csv").read_bytes() == (out / "table1.csv").read_bytes()


def test_a_sweep_refuses_cells_that_were_trained_otherwise(folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    settings = ("--seeds", "1", "--samples", "300", "--methods", "B")
    dappo_batch(*sweep(folder, out, *settings, *SMALL))
    before = files(out)
    _, err = dappo_batch(*sweep(folder, out, *settings, *SMALL, "dropout=0.3"), code=1)
    assert "trained with other settings" in err
    assert files(out) == before


@pytest.mark.slow
def test_a_sweep_trains_its_own_expert_when_it_is_given_none(tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    axes = ("--rollouts", "4", "--timesteps", "2", "--test-rollouts", "2", "--seeds", "1", "--methods", "A")
    budget = ("--robot", "ant", "--expert-steps", "32768", "--samples", "100")
    command = ("diagnose", "sweep", "--out", out, *axes, *budget, *SMALL)
    dappo_batch(*command)
    weights = files(out / "expert" / "checkpoints")
    table = (out / "table1.csv").read_bytes()
    dappo_batch(*command)
    assert files(out / "expert" / "checkpoints") == weights
    assert (out / "table1.csv").read_bytes() == table
