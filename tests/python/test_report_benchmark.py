"""The benchmark of a report: learners over classes and seeds, as shares of specialists, and as CSV."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from dappo_batch import ConfigError, report
from dappo_batch.report.benchmark import interquartile_mean, measure

from .command_line import dappo_batch
from .report_page import page_of
from .run_folders import CLASSES, write_run

TITLE = "ant: benchmark"


def write_specialist(
    path: Path, damage: str, reached: float, classes: Sequence[tuple[str, str]] = CLASSES, more: str = ""
) -> Path:
    """Write a run that was trained on one damage alone, and reaches nothing with the others."""
    own = set(damage.split("+"))
    rewards = [reached if set(name.split("+")) == own else 0.0 for name, _ in classes]
    run = write_run(path, rewards=rewards, classes=classes)
    config = run / "config.toml"
    text = config.read_text().replace('mix = "uniform"', f'mix = "{damage}"')
    config.write_text(text.replace("gamma = 0.99", f"gamma = 0.99\n{more}"))
    return run


def test_a_quarter_of_the_values_is_left_out_at_both_ends() -> None:
    # scipy.stats.trim_mean(values, 0.25) of SciPy 1.16: ten values lose two at each end, three lose none.
    values = np.array([7.0, 100.0, 3.0, -50.0, 5.0, 4.0, 8.0, 6.0, 2.0, 1.0])
    assert interquartile_mean(values) == pytest.approx(4.5)
    assert interquartile_mean(np.array([1.0, 2.0, 9.0])) == pytest.approx(4.0)
    np.testing.assert_allclose(interquartile_mean(np.array([[0.0, 1, 2, 30], [4.0, 4, 4, 4]])), [1.5, 4.0])


def test_intervals_resample_whole_seeds() -> None:
    # A resample of two seeds is the lower one twice, both, or the upper one twice with probability 1/4, 1/2
    # and 1/4. Classes that are drawn one by one would lie closer to the mean.
    names = ["a", "b", "c", "d", "e", "f"]
    low = np.array([10.0, 20.0, 30.0, 40.0, 50.0, 60.0])
    found = measure(np.array([low, low + 12]), names)
    assert (found.mean.value, found.mean.low, found.mean.high) == (41.0, 35.0, 47.0)
    iqm = found.interquartile_mean
    # Twelve values lose three at each end: (32 + 40 + 30 + 42 + 50 + 52) / 6, and of a seed twice its middle.
    assert (iqm.value, iqm.low, iqm.high) == (pytest.approx(41.0), 35.0, 47.0)
    # The five lowest of each seed, (30 + 42) / 2, and the lowest class, (10 + 22) / 2.
    assert (found.worst, found.lowest, found.lowest_class, found.classes) == (36.0, 16.0, "a", 6)
    alone = measure(low[None], names)
    assert alone.mean.value == 35.0
    assert np.isnan([alone.mean.low, alone.mean.high]).all()


def test_learners_are_measured_over_classes_and_seeds(tmp_path: Path) -> None:
    for seed in (0, 1):
        write_run(tmp_path / f"aware{seed}", seed=seed, rewards=(4.0 + 4 * seed, 3.0, 2.0, 1.0))
    write_run(tmp_path / "unaware", aware=False, rewards=(2.0, 2.0, 1.0, -2.0))
    page = page_of(tmp_path / "page.html", sorted(tmp_path.glob("*aware*")), TITLE)
    aware, unaware = page.table("interquartile mean")
    # Seeds have (4 + 3 + 2 + 1) / 4 = 2.5 and 3.5. The middle four of 8 4 3 3 2 2 1 1 are 3 3 2 2. The worst
    # five of four classes are all of them.
    assert aware["mean"] == "3.0 [2.5, 3.5]"
    assert aware["interquartile mean"] == "2.5 [2.5, 2.5]"
    assert (aware["seeds"], aware["worst 5"], aware["lowest class"]) == ("2", "3.0", "1.0 (missing_toe@1)")
    assert (unaware["mean"], unaware["seeds"], unaware["env steps"]) == ("0.8", "1", "400")
    assert unaware["training"] == "0.3 min"  # four iterations of 5 s
    assert unaware["falls"] == "n/a"
    assert "specialist" not in page.text


def test_shares_are_those_of_the_specialist_of_each_class(tmp_path: Path) -> None:
    write_run(tmp_path / "aware", rewards=(4.0, 3.0, 2.0, 1.0))
    write_specialist(tmp_path / "one", "healthy", 8.0)
    write_specialist(tmp_path / "two", "missing_toe@0", 4.0)
    write_specialist(tmp_path / "three", "missing_toe@0", 6.0)
    write_specialist(tmp_path / "four", "jammed_joint@0", -1.0)
    paths = [tmp_path / name for name in ("aware", "one", "two", "three", "four")]
    page = page_of(tmp_path / "page.html", paths, TITLE)
    # The policy for the healthy robot is a learner as well; a negative reference is none.
    aware, expert = page.table("mean, %")
    assert (aware["learner"], expert["learner"]) == ("DA-PPO", "expert")
    # Healthy 4 / 8, missing_toe@0 2 / ((4 + 6) / 2).
    assert aware["mean, %"] == "45.0"
    assert aware["lowest class, %"] == "40.0 (missing_toe@0)"
    assert (expert["mean, %"], expert["lowest class, %"]) == ("50.0", "0.0 (missing_toe@0)")
    assert "in 2 of 4 classes" in page.text
    assert {row["damage"]: row["forward reward"] for row in page.table("damage", "seed")} == {
        "healthy": "8.0",
        "jammed_joint@0": "-1.0",
        "missing_toe@0": "6.0",
    }


@pytest.mark.parametrize("is_symmetric", [True, False])
def test_a_class_without_a_specialist_has_that_of_its_mirror_image(
    tmp_path: Path, is_symmetric: bool
) -> None:
    # Limbs 0 and 3 of the Ant, and 1 and 2, are mirror images of each other.
    names = ("healthy", "missing_toe@3", "jammed_joint@2+missing_toe@3", "missing_toe@1")
    classes = [(name, "D") for name in names]
    write_run(tmp_path / "aware", rewards=(4.0, 3.0, 2.0, 1.0), classes=classes)
    settings = f"symmetry = {str(is_symmetric).lower()}"
    write_specialist(tmp_path / "healthy", "healthy", 8.0, classes, settings)
    left = [*classes, ("missing_toe@0", "D"), ("missing_toe@0+jammed_joint@1", "D")]
    write_specialist(tmp_path / "single", "missing_toe@0", 4.0, left, settings)
    write_specialist(tmp_path / "pair", "jammed_joint@1+missing_toe@0", 10.0, left, settings)
    paths = [tmp_path / name for name in ("aware", "healthy", "single", "pair")]
    report.write(paths, tmp_path / "page.html", csv=tmp_path / "table.csv", film_strips=False)
    rows = list(csv.DictReader(io.StringIO((tmp_path / "table.csv").read_text())))
    share = next(
        row for row in rows if row["measure"] == "share_of_specialist" and row["learner"] == "DA-PPO"
    )
    # 4 / 8, and with mirror images 3 / 4 and 2 / 10.
    expected = ("3", np.mean([0.5, 0.75, 0.2])) if is_symmetric else ("1", 0.5)
    assert (share["classes"], float(share["mean"])) == (expected[0], pytest.approx(expected[1], abs=1e-4))


def test_a_policy_from_elsewhere_stands_in_the_same_table(tmp_path: Path) -> None:
    run = write_run(tmp_path / "aware", rewards=(4.0, 3.0, 2.0, 1.0))
    peer = run / "eval" / "act-peer.act"
    other = run / "eval" / "act-other.act"
    rows = "class,name,group,episodes,forward_reward,falls\n"
    for folder, names in ((peer, [name for name, _ in CLASSES]), (other, ["healthy"])):
        folder.mkdir()
        (folder / "per_class.csv").write_text(
            rows + "".join(f"{index},{name},D,8,6.0,2\n" for index, name in enumerate(names))
        )
    page = page_of(tmp_path / "page.html", [run, peer, other], TITLE)
    _, row = page.table("interquartile mean")
    assert (row["learner"], row["mean"], row["falls"]) == ("act-peer.act", "6.0", "25.00 %")
    assert (row["seeds"], row["env steps"]) == ("n/a", "n/a")
    (note,) = page.notes
    assert note == "act-other.act is not in the tables: it was evaluated with other damage classes."


def test_the_table_is_written_as_csv(tmp_path: Path) -> None:
    write_run(tmp_path / "aware", rewards=(4.0, 3.0, 2.0, 1.0))
    write_run(tmp_path / "go1", trackings=(0.5, 0.4, 0.3, 0.2), robot="go1")
    out = ("--out", tmp_path / "page.html", "--no-film-strips")
    dappo_batch("report", tmp_path / "aware", tmp_path / "go1", *out, "--csv", tmp_path / "table.csv")
    rows = list(csv.DictReader(io.StringIO((tmp_path / "table.csv").read_text())))
    assert [(row["robot"], row["measure"], row["mean"]) for row in rows] == [
        ("ant", "forward_reward", "2.5000"),
        ("go1", "tracking", "0.3500"),
    ]
    assert (rows[0]["mean_low"], rows[0]["seeds"], rows[0]["training_seconds"]) == ("", "1", "20.0")
    with pytest.raises(ConfigError, match="there is no folder"):
        report.write([tmp_path / "aware"], tmp_path / "page.html", csv=tmp_path / "missing" / "table.csv")
