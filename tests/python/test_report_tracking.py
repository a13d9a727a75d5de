"""Reports of robots with commands: tracking in the place of the forward reward, and apart from it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import PathCollection
from matplotlib.figure import Figure

from dappo_batch import CheckpointError, load_run
from dappo_batch.report import strips
from dappo_batch.report.learners import learners
from dappo_batch.report.page import Section, Text, render
from dappo_batch.report.picture import Picture, style
from dappo_batch.report.sections import sections
from dappo_batch.report.sources import read

from .command_line import TINY, dappo_batch
from .report_page import Page, page_of
from .run_folders import write_adaptation, write_run, write_trace

AWARE, UNAWARE = (0.8, 0.6, 0.5, 0.3), (0.7, 0.4, 0.5, 0.2)
"""Tracking in four damage classes: healthy, D1, and two of D2."""


@pytest.fixture(scope="module")
def commanded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write two seeds of DA-PPO and one of PPO-Unaware, of a task with commands."""
    root = tmp_path_factory.mktemp("commanded")
    for seed in (0, 1):
        trackings = [share + 0.1 * seed for share in AWARE]
        write_run(root / f"aware{seed}", seed=seed, robot="go1", trackings=trackings, encodings=["zero"])
    write_run(root / "unaware0", robot="go1", aware=False, trackings=UNAWARE)
    write_adaptation(root / "aware0")
    write_trace(root / "walk.csv", has_commands=True)
    return root


def paths(folder: Path) -> list[Path]:
    return sorted(folder.iterdir())


def written(found: Sequence[Section], out: Path) -> Page:
    """Write sections as a page, and read it."""
    with style():
        out.write_text(render("Title", "Subtitle", found), encoding="utf-8")
    return Page(out)


def pictures(found: Sequence[Section]) -> dict[str, Picture]:
    drawn = [picture for section in found for picture in section.pictures]
    assert len({picture.name for picture in drawn}) == len(drawn)
    return {picture.name: picture for picture in drawn}


def drawing(picture: Picture) -> Figure:
    with style():
        figure = picture.draw(4.0)
        FigureCanvasAgg(figure).draw()
    return figure


def test_nothing_in_a_report_of_a_robot_with_commands_is_a_forward_reward(
    commanded: Path, tmp_path: Path
) -> None:
    with style():
        found = sections(read(paths(commanded)), with_strips=False)
    page = written(found, tmp_path / "page.html")
    text = page.text.lower()
    for word in ("forward reward", "forward velocity", "m/s", "distance", "m per episode"):
        assert word not in text
    assert "Tracking is how well commanded velocities are tracked, from 0 to 1" in page.text


def test_tables_have_the_tracking_with_three_decimals(commanded: Path, tmp_path: Path) -> None:
    page = page_of(tmp_path / "page.html", paths(commanded), "Overview", "go1: evaluation")
    # Means over 4 classes: 2.2 / 4 and, with 0.1 more, 2.6 / 4; unaware 1.8 / 4. Eight independent errors of
    # 0.02 each make 0.02 / sqrt(8), four 0.02 / sqrt(4).
    aware, unaware = page.table("learner", "tracking", "lowest seed")
    assert (aware["tracking"], aware["lowest seed"], aware["highest seed"]) == (
        "0.600 ± 0.007",
        "0.550",
        "0.650",
    )
    assert unaware["tracking"] == "0.450 ± 0.010"
    assert ("0.600", "tracking of DA-PPO, go1") in page.tiles
    assert ("+33.3 %", "tracking of DA-PPO compared with PPO-Unaware") in page.tiles
    assert len(page.tiles) == 3, "no speed"
    (gain,) = page.table("gain")
    # The first class is 0.85 against 0.7, the third 0.55 against 0.5.
    assert (gain["gain"], gain["classes ahead"]) == ("+33.3 %", "4 of 4")
    groups = {row["group"]: row["DA-PPO"] for row in page.table("group", "damage")}
    # D2: (0.5 + 0.3) / 2 and 0.1 more; its error of a seed is 0.02 / sqrt(2), that of two 0.02 / sqrt(4).
    assert groups["D2"] == "0.450 ± 0.010"


def test_figures_draw_the_tracking_and_no_distance(commanded: Path) -> None:
    found = pictures(sections(read(paths(commanded)), with_strips=False))
    for name in ("go1-groups", "go1-classes", "go1-encodings"):
        (axes,) = drawing(found[name]).axes
        assert axes.get_xlabel() == "tracking (0 to 1)"
        assert axes.child_axes == [], "no second axis in m"
        assert found[name].caption.startswith("Tracking")
    (axes,) = drawing(found["go1-against-0"]).axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("tracking of PPO-Unaware", "tracking of DA-PPO")
    markers = [points for points in axes.collections if isinstance(points, PathCollection)]
    offsets = [np.asarray(points.get_offsets()) for points in markers]
    expected = np.stack([UNAWARE, np.array(AWARE) + 0.05], axis=1)
    np.testing.assert_allclose(np.concatenate(offsets), expected)


def test_curves_show_the_tracking_in_training_and_of_evaluations(commanded: Path) -> None:
    found = pictures(sections(read(paths(commanded)), with_strips=False))
    assert "go1-training-forward-reward" not in found
    curve, evaluated = (found[f"go1-training-{name}"] for name in ("tracking", "evaluation-tracking"))
    assert curve.caption.startswith("Tracking in training, of the env steps, with exploration noise.")
    assert evaluated.title == "Tracking of evaluations"
    # 100 env steps an iteration; evaluations follow every second one.
    for picture, steps, values in (
        (curve, [100, 200, 300, 400], [0.1, 0.2, 0.3, 0.4]),
        (evaluated, [200, 400], [0.4, 0.8]),
    ):
        (axes,) = drawing(picture).axes
        assert axes.get_ylabel() == "0 to 1"
        assert axes.child_axes == []
        for line in axes.lines:
            np.testing.assert_allclose(line.get_xydata(), np.stack([steps, values], axis=1))


def test_what_a_robot_with_commands_keeps_is_a_share_of_the_oracles_tracking(
    commanded: Path, tmp_path: Path
) -> None:
    found = pictures(sections(read(paths(commanded)), with_strips=False))
    picture = found["adaptation-tracking"]
    assert picture.title == "Share of the oracle's tracking"
    (axes,) = drawing(picture).axes
    assert axes.get_xlabel() == "% of the oracle's tracking"
    assert "adaptation" not in found
    walk = found["walk-0"]
    assert walk.caption.startswith("Tracking, mean over the last 25 steps.")
    (axes,) = drawing(walk).axes
    assert axes.get_ylabel() == "tracking, 0 to 1"
    curve = next(line for line in axes.lines if len(np.asarray(line.get_xdata())) == 60)
    np.testing.assert_allclose(curve.get_ydata(), 1 - np.arange(60) / 100)
    page = page_of(tmp_path / "page.html", [commanded / "walk.csv"], "Single episodes")
    # The mean of 1 - step / 100 over steps 20 to 59 is 0.605.
    (row,) = page.table("episode", "tracking")
    assert row["tracking"] in ("0.60", "0.61")


def test_robots_with_and_without_commands_share_a_report_but_no_table_and_no_figure(
    commanded: Path, tmp_path: Path
) -> None:
    write_run(tmp_path / "ant0", rewards=(4.0, 3.0, 2.0, 1.0))
    write_adaptation(tmp_path / "ant0")
    write_trace(tmp_path / "walk.csv")
    given = [*paths(commanded), *paths(tmp_path)]
    found = sections(read(given), with_strips=False)
    page = written(found, tmp_path / "page.html")
    (ant,) = page.table("learner", "forward reward", "m/s")
    assert ant["forward reward"] == "2.5 ± 0.2"
    assert len(page.table("learner", "tracking", "lowest seed")) == 2
    drawn = pictures(found)
    for name, picture in drawn.items():
        shown = " ".join([*_axis_labels(picture), picture.title, picture.caption]).lower()
        assert not ("tracking" in shown and "forward" in shown), name
        if name.startswith("ant-") and "training-" not in name:
            assert "forward reward" in shown or "throughput" in name
    assert {"adaptation", "adaptation-tracking", "walk-0", "walk-1"} <= drawn.keys()
    assert "adaptation" in page.text


def _axis_labels(picture: Picture) -> list[str]:
    return [text for axes in drawing(picture).axes for text in (axes.get_xlabel(), axes.get_ylabel())]


def test_a_robot_with_two_tasks_counts_as_two(tmp_path: Path) -> None:
    write_run(tmp_path / "one", robot="robots/crawler.toml")
    write_run(tmp_path / "other", robot="robots/crawler.toml", aware=False, trackings=UNAWARE)
    found = learners([load_run(path) for path in paths(tmp_path)])
    assert [(each.robot, each.name, each.place, each.score.name) for each in found] == [
        ("crawler (forward reward)", "DA-PPO", 0, "forward reward"),
        ("crawler (tracking)", "PPO-Unaware", 0, "tracking"),
    ]
    page = page_of(tmp_path / "page.html", paths(tmp_path)[:2], "Overview")
    assert "gain" not in {cell for table in page.tables for cell in table[0]}


def test_a_run_that_is_not_evaluated_yet_is_recognised_by_its_metrics(tmp_path: Path) -> None:
    for name, trackings in (("one", UNAWARE), ("two", None)):
        (write_run(tmp_path / name, trackings=trackings) / "eval" / "per_class.csv").unlink()
        (learner,) = learners([load_run(tmp_path / name)])
        assert learner.score.name == ("forward reward" if trackings is None else "tracking")


def test_a_trace_with_a_tracking_that_is_no_number_is_rejected(tmp_path: Path) -> None:
    trace = write_trace(tmp_path / "walk.csv", has_commands=True)
    trace.write_text(trace.read_text().replace(",0.95\n", ",much\n"))
    with pytest.raises(CheckpointError, match=r"walk\.csv: not every tracking is a number"):
        read([trace])


@pytest.fixture(scope="module")
def go1(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train a policy of the Go1 for a moment."""
    run = tmp_path_factory.mktemp("go1") / "run"
    dappo_batch("train", "--robot", "go1", "--steps", "128", "--run", run, *TINY, "evaluation.every=1")
    return run


@pytest.mark.slow
def test_the_run_of_a_go1_has_what_its_report_shows(go1: Path) -> None:
    run = load_run(go1)
    names = {"go1-training-tracking", "go1-training-evaluation-tracking", "go1-classes", "go1-groups"}
    with style():
        found = pictures(sections(read([go1]), with_strips=False))
    assert names <= found.keys()
    # The weight of the term is 1 in the task `velocity`.
    np.testing.assert_allclose(run.metrics["tracking"], run.metrics["reward_track_lin_vel"])
    last = run.groups["true"]["tracking"][-1]
    assert run.metrics["evaluation_tracking"][-1] == pytest.approx(last, abs=1e-4)
    np.testing.assert_allclose(run.per_class["true"]["tracking"].mean(), last, atol=1e-4)


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
def test_a_film_strip_of_a_go1_has_its_command_and_no_distance(go1: Path, tmp_path: Path) -> None:
    about, strip, *rest = strips.strips(learners([load_run(go1)]))
    assert rest == []
    assert isinstance(about, Text)
    assert "median tracking of all damage classes" in about.text
    page = written([Section("strips", "Strips", [about, strip])], tmp_path / "page.html")
    (drawn,) = page.strips
    assert len(drawn) == 6
    assert " m in " not in page.text
    assert "m/s forwards" in page.text
