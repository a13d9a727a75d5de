"""What reports draw: learners, their numbers, and figures whose texts leave each other room."""

from __future__ import annotations

import itertools
from pathlib import Path
from unittest import mock

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.text import Text

import dappo_batch
from dappo_batch import load_run
from dappo_batch.report.figures import evaluation, training
from dappo_batch.report.figures.adaptation import shares
from dappo_batch.report.learners import learners, matched
from dappo_batch.report.names import short_names
from dappo_batch.report.picture import style
from dappo_batch.report.sections import sections
from dappo_batch.report.sources import read

from .run_folders import write_adaptation, write_diagnoser, write_run, write_sweep, write_trace


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write two seeds of DA-PPO and one of PPO-Unaware."""
    root = tmp_path_factory.mktemp("runs")
    for seed in (0, 1):
        write_run(root / f"aware{seed}", seed=seed, rewards=(4.0 + seed, 3.0, 2.0, 1.0))
    write_run(root / "unaware0", aware=False)
    write_adaptation(root / "aware0")
    return root


def test_runs_that_differ_in_their_seed_alone_are_one_learner(folder: Path, tmp_path: Path) -> None:
    other = write_run(tmp_path / "other", seed=2, more="horizon = 64")
    runs = [load_run(path) for path in (folder / "unaware0", other, folder / "aware1", folder / "aware0")]
    found = learners(runs)
    assert [learner.label() for learner in found] == [
        "DA-PPO, horizon 64, 1 seed",
        "DA-PPO, horizon default, 2 seeds",
        "PPO-Unaware, 1 seed",
    ]
    assert [run.seed for run in found[1].runs] == [0, 1]


def test_a_curve_weighs_iterations_by_their_episodes(tmp_path: Path) -> None:
    run = load_run(write_run(tmp_path / "run", forward_rewards=[float(n) for n in range(1, 101)]))
    (learner,) = learners([run])
    curve = learner.curve("forward_reward", weighted=True)
    assert curve is not None
    np.testing.assert_allclose(curve.env_steps, 200.0 * np.arange(1, 51))
    pairs = np.arange(1.0, 101.0).reshape(50, 2)
    np.testing.assert_allclose(curve.values, [(pairs**2).sum(1) / pairs.sum(1)])
    plain = learner.curve("rollout_seconds", weighted=False)
    assert plain is not None
    np.testing.assert_allclose(plain.values, 2.0)
    assert learner.curve("entropy", weighted=False) is None


def test_a_span_without_episodes_has_no_value(tmp_path: Path) -> None:
    (learner,) = learners([load_run(write_run(tmp_path / "run"))])
    curve = learner.curve("forward_reward", weighted=True)
    assert curve is not None
    np.testing.assert_array_equal(curve.values, [[1.0, np.nan, 3.0, 5.0]])


def test_groups_weigh_their_classes_equally(folder: Path) -> None:
    (learner,) = learners([load_run(folder / f"aware{seed}") for seed in (0, 1)])
    scores = learner.scores().of_groups()
    means = dict(zip(scores.names, scores.values.T.tolist(), strict=True))
    assert means == {"none": [4.0, 5.0], "D1": [3.0, 3.0], "D2": [1.5, 1.5], "all": [2.5, 2.75]}
    # As `evaluate` writes them into groups.csv: the root of the sum of squares, divided by their number.
    np.testing.assert_allclose(scores.errors[0], [0.5, 0.5, np.sqrt(2 * 0.25) / 2, np.sqrt(4 * 0.25) / 4])
    assert scores.over_seeds()[1][-1] == pytest.approx(np.sqrt(8 * 0.25) / 8)


def test_figures_draw_the_standard_errors_of_the_table(folder: Path) -> None:
    (learner,) = learners([load_run(folder / "aware0")])
    with style():
        (picture,) = evaluation.classes("ant", [learner], 0.05)
        figure = picture.draw(4.0)
        FigureCanvasAgg(figure).draw()
        axes = figure.axes[0]
    segments = np.array(_lines(axes.collections[0]).get_segments())
    table = learner.runs[0].per_class["true"]
    rewards, errors = table["forward_reward"], table["standard_error"]
    np.testing.assert_allclose(segments[:, :, 0], np.stack([rewards - errors, rewards + errors], axis=1))
    assert "standard error" in picture.caption
    second = axes.child_axes[0]
    assert second.get_xlabel() == "distance, m"
    np.testing.assert_allclose(np.array(second.get_xlim()), 0.05 * np.array(axes.get_xlim()))


def _lines(artist: object) -> LineCollection:
    assert isinstance(artist, LineCollection)
    return artist


def test_without_standard_errors_there_are_no_bars(tmp_path: Path) -> None:
    (learner,) = learners([load_run(write_run(tmp_path / "run", errors=None))])
    with style():
        (picture,) = evaluation.classes("ant", [learner], None)
        axes = picture.draw(4.0).axes[0]
    segments = np.array(_lines(axes.collections[0]).get_segments())
    np.testing.assert_array_equal(segments[:, 0], segments[:, 1])
    assert "standard error" not in picture.caption
    assert axes.child_axes == []


def test_a_band_needs_several_seeds(folder: Path) -> None:
    for names, bands in ((("aware0",), 0), (("aware0", "aware1"), 1)):
        (learner,) = learners([load_run(folder / name) for name in names])
        with style():
            picture = training.curves("ant", [learner], "entropy", "E", "nats", weighted=False)
            assert picture is None, "the runs have no such column"
            picture = training.curves("ant", [learner], "fall_rate", "Falls", "share", weighted=True)
            assert picture is not None
            drawing = picture.draw(4.0).axes[0]
        assert len(drawing.collections) == bands
        assert ("band" in picture.caption) == bool(bands)


def test_da_ppo_is_compared_with_the_ppo_unaware_of_the_same_settings(tmp_path: Path) -> None:
    for aware in (False, True):
        for horizon in (32, 64):
            write_run(tmp_path / f"{aware}{horizon}", aware=aware, more=f"horizon = {horizon}")
    found = learners([load_run(path) for path in sorted(tmp_path.iterdir())])
    assert [(one.name, other.name) for one, other in matched(found)] == [
        ("DA-PPO, horizon 32", "PPO-Unaware, horizon 32"),
        ("DA-PPO, horizon 64", "PPO-Unaware, horizon 64"),
    ]
    # Where none has the same settings, all are compared.
    assert len(matched([found[0], found[3]])) == 1


@pytest.mark.parametrize(
    ("paths", "names"),
    [
        (["runs/ant-aware-s0"], ["ant-aware-s0"]),
        (["runs/ant-aware-s0", "runs/ant-unaware-s0"], ["aware-s0", "unaware-s0"]),
        # A number alone would say too little.
        (["runs/aware-0", "runs/aware-1"], ["aware-0", "aware-1"]),
        (["a/run", "b/run"], ["a/run", "b/run"]),
        (["runs/sweep/seed=0,x=1", "runs/sweep/seed=1,x=1"], ["seed=0,x=1", "seed=1,x=1"]),
        # What begins with another name is not that name.
        (["runs/ant", "runs/ant-2"], ["ant", "ant-2"]),
    ],
)
def test_short_names(paths: list[str], names: list[str]) -> None:
    assert list(short_names([Path("/data", path) for path in paths]).values()) == names


def test_short_names_of_long_folders_differ() -> None:
    paths = [Path("/data") / f"{'x' * 60}{number:02d}{'y' * 60}" for number in range(12)]
    names = list(short_names(paths).values())
    assert len(set(names)) == 12
    assert max(map(len, names)) <= 32


@pytest.mark.parametrize("count", [1, *(pytest.param(count, marks=pytest.mark.slow) for count in (2, 12))])
def test_no_text_of_a_figure_covers_another(tmp_path: Path, count: int) -> None:
    """With long names, and as many learners as runs."""
    classes = dappo_batch.compile_class_table("ant").space.classes
    word = "a-long-name-of-a-folder-of-a-run-in-a-sweep"
    for number in range(count):
        run = write_run(
            tmp_path / f"{word}-{number:02d}-{word}",
            aware=number % 2 == 0,
            classes=[(each.name, each.group) for each in classes],
            rewards=[number + each.id % 5 for each in classes],
            encodings=["zero"] if number % 2 == 0 else [],
            more=f"horizon = {32 + number // 2}\nanother_long_setting = {number // 2}",
        )
        write_adaptation(run)
        write_trace(tmp_path / f"{word}-{number:02d}-{word}.csv")
        write_diagnoser(tmp_path / f"{word}-diagnoser-{number:02d}")
    write_sweep(tmp_path / "table")
    drawn = 0
    with style():
        for section in sections(read(sorted(tmp_path.iterdir())), with_strips=False):
            for picture, width in itertools.product(section.pictures, (4.0, 12.7)):
                covered = _covered(picture.draw(width))
                assert covered == [], (picture.name, width, covered)
                drawn += 1
    assert drawn > 20


def _covered(figure: Figure) -> list[tuple[str, str]]:
    """Return the pairs of texts that overlap, and those that leave the figure with its frame."""
    drawn: list[Text] = []
    draw = Text.draw
    # Axes also have ticks outside of their limits, which are not drawn.
    with mock.patch.object(Text, "draw", lambda text, renderer: (drawn.append(text), draw(text, renderer))):
        FigureCanvasAgg(figure).draw()
    boxes = []
    for text in drawn:
        box = text.get_window_extent()
        if text.get_visible() and text.get_text().strip():
            boxes.append((text.get_text(), box.x0 + 1, box.y0 + 1, box.x1 - 1, box.y1 - 1))
    frame = ("the frame", figure.bbox.x0 - 2, figure.bbox.y0 - 2, figure.bbox.x1 + 2, figure.bbox.y1 + 2)
    found = [
        (one[0], frame[0])
        for one in boxes
        if one[1] < frame[1] or one[2] < frame[2] or one[3] > frame[3] or one[4] > frame[4]
    ]
    for one, other in itertools.combinations(dict.fromkeys(boxes), 2):
        if one[1] < other[3] and other[1] < one[3] and one[2] < other[4] and other[2] < one[4]:
            found.append((one[0], other[0]))
    return found


def test_shares_of_the_oracle_leave_the_healthy_robot_out(folder: Path) -> None:
    table = load_run(folder / "aware0").adaptation
    assert table is not None
    assert shares(table) == {"adapted": 0.9, "no_adaptation": 0.5}
