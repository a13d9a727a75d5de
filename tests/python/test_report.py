"""`dappo-batch report`: one page that needs nothing else, and its figures as files."""

from __future__ import annotations

import io
import json
import re
import resource
import shutil
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from PIL import Image

import dappo_batch
from dappo_batch import CheckpointError, ConfigError, MissingExtraError, load_run, report
from dappo_batch.report import strips
from dappo_batch.report.learners import learners
from dappo_batch.report.page import Note, Section, render
from dappo_batch.report.picture import style
from dappo_batch.report.sections import sections
from dappo_batch.report.sources import read

from .. import processes
from .command_line import dappo_batch as dappo_batch_run
from .command_line import dappo_batch_many, files
from .report_page import Page, page_of
from .run_folders import write_adaptation, write_diagnoser, write_run, write_sweep, write_trace

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None
)
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--enable-logging=stderr"),
)
SMOKE = Path(__file__).parents[2] / "configs" / "smoke.toml"


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train a policy for a moment."""
    run = tmp_path_factory.mktemp("report") / "run"
    dappo_batch_run("train", "--config", SMOKE, "--run", run)
    return run


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write two learners with two seeds each, a sweep, a diagnoser and a trace, and their report."""
    root = tmp_path_factory.mktemp("report")
    for seed in (0, 1):
        write_run(root / f"aware{seed}", seed=seed, rewards=(4.0 + seed, 3.0, 2.0, 1.0), encodings=["zero"])
        write_run(root / f"unaware{seed}", seed=seed, aware=False, rewards=(2.0 + seed, 2.0, 1.0, 2.0))
    write_adaptation(root / "aware0")
    write_sweep(root / "sweep")
    write_diagnoser(root / "diagnoser")
    write_trace(root / "walk.csv")
    names = ("aware0", "aware1", "unaware0", "unaware1", "sweep", "diagnoser", "walk.csv")
    report.write(
        [root / name for name in names],
        root / "report.html",
        figures=root / "figures",
        title="Runs <of> $June$ & July",
    )
    return root


def test_a_page_has_a_section_for_everything_that_was_given(folder: Path) -> None:
    page = Page(folder / "report.html")
    assert page.headings == [
        "Overview",
        "ant: training",
        "ant: benchmark",
        "ant: evaluation",
        "ant: damage classes",
        "ant: film strips",
        "Damage during an episode",
        "Single episodes",
        "Table 1: accuracy of the diagnosis",
        "Diagnosis",
        "Throughput",
        "Configuration and versions",
    ]
    assert "<h1>Runs &lt;of&gt; $June$ &amp; July</h1>" in page.text
    cells = {cell for table in page.tables for row in table for cell in row}
    assert {"75.00 %", "lanes", "diagnosed broken (0.97)"} <= cells
    assert "gamma = 0.99" in page.text
    assert len(page.notes) == 2
    for name, note in zip(("DA-PPO", "PPO-Unaware"), page.notes, strict=True):
        assert note.startswith(f"There is no film strip of {name}: ")
        assert note.endswith("holds no checkpoint")


def test_rewards_are_also_given_as_speeds_and_distances(folder: Path) -> None:
    page = Page(folder / "report.html")
    # Means over 4 classes and 2 seeds: (10 + 11) / 8 and (7 + 8) / 8. Eight independent errors of 0.5 each
    # make 0.5 / sqrt(8). Episodes have 50 steps; a step of the Ant lasts 5 times 0.01 s.
    aware, unaware = page.table("m/s", "m per episode")
    assert (aware["forward reward"], aware["lowest seed"], aware["highest seed"]) == (
        "2.6 ± 0.2",
        "2.5",
        "2.8",
    )
    assert (aware["m/s"], aware["m per episode"]) == ("0.05", "0.1")
    assert (unaware["forward reward"], unaware["env steps"]) == ("1.9 ± 0.2", "400")
    (gain,) = page.table("gain")
    assert (gain["gain"], gain["classes ahead"], gain["budgets"]) == ("+40.0 %", "3 of 4", "equal")
    assert page.flags == []


def test_the_legend_explains_each_short_name(folder: Path) -> None:
    rows = Page(folder / "report.html").table("run", "folder")
    assert [row["run"] for row in rows] == ["aware0", "aware1", "unaware0", "unaware1"]
    for row in rows:
        run = load_run(row["folder"])
        assert (row["learner"] == "DA-PPO", row["seed"]) == (run.observes_damage, str(run.seed))
        assert (row["robot"], row["reward"], row["env steps"]) == ("ant", "gym", "400")


def test_budgets_that_differ_and_runs_that_are_not_finished_are_flagged(tmp_path: Path) -> None:
    write_run(tmp_path / "long", forward_rewards=[1.0] * 8)
    write_run(tmp_path / "short", seed=1)
    write_run(tmp_path / "stopped", aware=False, total=800)
    paths = [tmp_path / name for name in ("long", "short", "stopped")]
    page = page_of(tmp_path / "page.html", paths, "Overview")
    assert page.flags == ["400", "400", "400", "400"]
    budgets, unfinished = page.notes
    assert "DA-PPO, 800 env steps: 800; PPO-Unaware: 400 env steps" in budgets
    assert unfinished == "stopped is not finished: 400 of 800 env steps."
    assert {row["run"]: row["env steps"] for row in page.table("run", "folder")} == {
        "long": "800",
        "short": "400",
        "stopped": "400",
    }


def test_a_page_needs_nothing_else(folder: Path) -> None:
    page = Page(folder / "report.html")
    assert all(link.startswith(("#", "data:")) for link in page.links)
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    assert "http" not in page.text.replace("http-equiv", "")
    assert not re.search(r"url\((?!#)|@import", page.text)


def test_figures_follow_light_and_dark(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    drawings = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    # A phone gets its own drawing of figures that are wide elsewhere, and legends have small drawings.
    figures = [drawing for drawing in drawings if 'role="img"' in drawing]
    assert len(figures) == text.count("<figure ") + text.count('class="wide"') > 20
    assert len(re.findall("<figure ", text)) > 10
    for drawing in drawings:
        assert drawing not in figures or "var(--ink)" in drawing
        # Bitmaps hold letters and digits that look like anything.
        assert not re.search(r"#[0-9a-f]{6}\b", re.sub(r'"data:[^"]*"', "", drawing))
    assert "@media (prefers-color-scheme: dark)" in text
    # The number of columns of a figure is no colour.
    for name in set(re.findall(r"var\((--[a-z0-9-]+)\)", text)) - {"--columns"}:
        assert len(re.findall(rf"{name}: #", text)) == 3, "light, dark by choice, dark by the system"


def test_every_figure_is_written_as_png_and_svg(folder: Path) -> None:
    written = sorted(path.name for path in (folder / "figures").iterdir())
    names = sorted({name.rpartition(".")[0] for name in written})
    assert written == sorted(f"{name}.{kind}" for name in names for kind in ("png", "svg"))
    assert len(names) == (folder / "report.html").read_text().count("<figure ")
    for path in (folder / "figures").iterdir():
        if path.suffix == ".svg":
            assert ElementTree.parse(path).getroot().tag.endswith("svg")
        else:
            assert path.read_bytes().startswith(b"\x89PNG")
    assert "91.25" in (folder / "figures" / "table1-0.svg").read_text()
    assert "78.20" in (folder / "figures" / "table1-0.svg").read_text(), "the paper's"


def test_the_same_data_give_the_same_page(folder: Path, tmp_path: Path) -> None:
    paths = [folder / "walk.csv", folder / "diagnoser"]
    report.write(paths, tmp_path / "one.html")
    report.write([*paths, folder / ".." / folder.name / "walk.csv"], tmp_path / "two.html")
    assert (tmp_path / "one.html").read_bytes() == (tmp_path / "two.html").read_bytes()
    assert Page(tmp_path / "one.html").headings == ["Single episodes", "Diagnosis"], "nothing about runs"


def test_groups_are_explained(tmp_path: Path) -> None:
    write_run(tmp_path / "run")
    rows = {
        "D1": "one limb: jammed_joint",
        "D1_2 A": "2 limbs: jammed_joint and missing_toe on adjacent limbs",
        "D2_2 S": "2 limbs: missing_toe and missing_toe on limbs neither adjacent nor opposite",
        "D1_1 O": "2 limbs: jammed_joint and jammed_joint on opposite limbs",
        "D1_1_2": "3 limbs: jammed_joint and jammed_joint and missing_toe",
    }
    space = dappo_batch.compile_class_table("hexapod", max_damaged_limbs=3).space
    classes = [next(each for each in space.classes if each.group == group) for group in rows]
    table = "".join(f"{each.id},{each.name},{each.group},1,1.0,\n" for each in classes)
    (tmp_path / "run" / "eval" / "per_class.csv").write_text(
        f"class,name,group,episodes,forward_reward,standard_error\n{table}"
    )
    page = page_of(tmp_path / "page.html", [tmp_path / "run"], "ant: evaluation")
    explained = {row["group"]: row["damage"] for row in page.table("group", "damage")}
    assert explained == rows | {"all": "all classes, equally weighted"}


def test_settings_that_are_too_long_for_a_name_stand_in_a_table(tmp_path: Path) -> None:
    for number in range(2):
        settings = f"horizon = {32 + number}\nsomething_with_a_rather_long_name = {number}"
        write_run(tmp_path / f"run{number}", more=settings)
    page = page_of(tmp_path / "page.html", [tmp_path / "run0", tmp_path / "run1"], "Overview")
    rows = page.table("settings")
    assert {row["learner"]: row["settings"] for row in rows} == {
        "DA-PPO A": "horizon 32, something with a rather long name 0",
        "DA-PPO B": "horizon 33, something with a rather long name 1",
    }


def test_a_sweep_is_drawn_like_its_runs(tmp_path: Path) -> None:
    sweep = tmp_path / "sweep"
    cells = [
        write_run(sweep / f"seed={seed},unaware={word}", seed=seed, aware=word == "false")
        for seed in (0, 1)
        for word in ("false", "true")
    ]
    (sweep / "sweep.json").write_text('{"base": {}}')
    page = page_of(tmp_path / "sweep.html", [sweep, cells[0]], "Overview")
    assert page.text == page_of(tmp_path / "runs.html", sorted(cells), "Overview").text
    assert [row["run"] for row in page.table("run", "folder")] == [
        "seed=0,unaware=false",
        "seed=1,unaware=false",
        "seed=0,unaware=true",
        "seed=1,unaware=true",
    ]
    write_run(sweep / "seed=2,unaware=false", seed=2, forward_rewards=[])
    sources = read([sweep])
    assert [run.path for run in sources.runs] == sorted(cells)
    assert sources.notes == [
        "Left out of the sweep sweep: seed=2,unaware=false, which finished no iteration yet."
    ]


def test_a_sweep_without_a_run_or_with_a_link_is_rejected(tmp_path: Path) -> None:
    sweep = tmp_path / "sweep"
    sweep.mkdir()
    (sweep / "sweep.json").write_text('{"base": {}}')
    with pytest.raises(ConfigError, match="no training that has finished an iteration"):
        read([sweep])
    (sweep / "seed=0").symlink_to(write_run(tmp_path / "elsewhere"))
    with pytest.raises(CheckpointError, match="seed=0 is a symbolic link, expected a folder"):
        read([sweep])


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
def test_film_strips_show_moments_of_an_episode(trained: Path, tmp_path: Path) -> None:
    (learner,) = learners([load_run(trained)])
    section = Section("strips", "Strips", strips.strips([learner]))
    (tmp_path / "page.html").write_text(render("Title", "Subtitle", [section]), encoding="utf-8")
    page = Page(tmp_path / "page.html")
    assert page.notes == []
    (strip,) = page.strips
    assert len(strip) == 6
    pictures = [np.asarray(Image.open(io.BytesIO(jpeg))) for jpeg in strip]
    assert {picture.shape for picture in pictures} == {(240, 320, 3)}
    assert all(picture.std() > 10 for picture in pictures), "not empty"
    assert np.abs(pictures[0].astype(float) - pictures[-1]).mean() > 1, "something has moved"
    # The distance is that of the main body along x, which RK4 evaluates in its last stage.
    episode = strips._episode(learner.runs[0], "missing_toe@1")
    states, velocities = episode.walk.states, np.array(episode.velocities)
    assert states[-1, 0] - states[0, 0] == pytest.approx(0.05 * velocities.sum(), abs=1e-4)


def test_where_nothing_can_be_drawn_a_note_has_the_reason(
    trained: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("dappo_batch.render.opengl.PAINTER", ("-c", "raise SystemExit('no driver')"))
    (note,) = strips.strips(learners([load_run(trained)]))
    assert isinstance(note, Note)
    reason = "pictures need OpenGL, and no implementation works"
    assert note.text.startswith(f"There is no film strip of DA-PPO: {reason}")
    with style():
        titles = [section.title for section in sections(read([trained]), with_strips=False)]
    assert "ant: film strips" not in titles


def test_film_strips_can_be_left_out_on_the_command_line(trained: Path, tmp_path: Path) -> None:
    pages = [tmp_path / "with.html", tmp_path / "without.html"]
    done = dappo_batch_many(
        ("report", trained, "--out", pages[0]), ("report", trained, "--out", pages[1], "--no-film-strips")
    )
    assert [code for code, _, _ in done] == [0, 0]
    assert ["ant: film strips" in page.read_text() for page in pages] == [True, False]


def test_an_unknown_kind_of_path_is_in_the_error_and_nothing_is_written(folder: Path, tmp_path: Path) -> None:
    foreign, young = tmp_path / "foreign.csv", tmp_path / "young"
    foreign.write_text("a,b\n1,2\n")
    write_run(young, forward_rewards=[])
    out = tmp_path / "out"
    out.mkdir()
    arguments = ("--out", out / "page.html", "--figures", out / "figures")
    expected = {
        tmp_path / "nowhere": "nowhere does not exist; expected a run folder",
        tmp_path: "has no config.toml, sweep.json or table1.csv; expected a run folder",
        foreign: "foreign.csv begins with 'a,b'; expected a run folder",
        young: "young has finished no iteration yet",
    }
    commands = [("report", folder / "aware0", path, *arguments) for path in expected]
    commands.append(("report", folder / "aware0", "--out", tmp_path / "missing" / "page.html"))
    commands.append(("report",))
    done = dappo_batch_many(*commands)
    assert [code for code, _, _ in done] == [1, 1, 1, 1, 1, 2]
    messages = [*expected.values(), "there is no folder", "<PATH>"]
    for (_, _, err), message in zip(done, messages, strict=True):
        assert message in err
        assert "Traceback" not in err
    assert files(out) == {}


def test_a_report_of_nothing_is_rejected(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="there is nothing to report"):
        report.write([], tmp_path / "report.html")


def test_a_table_that_is_cut_short_is_rejected(tmp_path: Path) -> None:
    trace = write_trace(tmp_path / "walk.csv")
    trace.write_text(trace.read_text()[:-10])
    with pytest.raises(CheckpointError, match=r"walk.csv: row 61 has \d entries, expected 5"):
        read([trace])
    confusion = write_diagnoser(tmp_path / "diagnoser") / "eval" / "test.confusion.csv"
    confusion.write_text("true\\diagnosed,healthy,broken\nhealthy,2,0\n")
    with pytest.raises(CheckpointError, match="rows and columns have different classes"):
        read([tmp_path / "diagnoser"])


def test_a_failure_in_writing_keeps_the_old_page(folder: Path, tmp_path: Path) -> None:
    page = tmp_path / "report.html"
    page.write_text("old")
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    # As on a full disk, a part of the page can be written.
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, limits[1]))
    try:
        with pytest.raises(ConfigError, match=r"cannot be written: .*File too large"):
            report.write([folder / "walk.csv"], page)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert files(tmp_path) == {"report.html": b"old"}
    with pytest.raises(ConfigError, match="cannot be written"):
        report.write([folder / "walk.csv"], tmp_path / "new.html", figures=page)
    assert files(tmp_path) == {"report.html": b"old"}


def test_without_matplotlib_the_message_contains_what_to_install(
    folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(
        MissingExtraError, match=r"matplotlib is not installed.*pip install 'dappo-batch\[report\]'"
    ):
        report.write([folder / "aware0"], tmp_path / "report.html")


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_a_browser_shows_the_page_without_a_complaint(folder: Path, tmp_path: Path, scheme: str) -> None:
    assert CHROMIUM is not None
    dark = ["--blink-settings=preferredColorScheme=0"] if scheme == "dark" else []
    profile, address = f"--user-data-dir={tmp_path}", (folder / "report.html").as_uri()
    done = processes.run([CHROMIUM, *FLAGS, *dark, profile, "--dump-dom", address], timeout=60)
    assert done.returncode == 0, done.stderr
    assert "CONSOLE" not in done.stderr
    # The script of the page has run: the switch offers the other theme.
    assert f">{'Light' if scheme == 'dark' else 'Dark'}</button>" in done.stdout


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium")
@pytest.mark.parametrize(("width", "shown", "hidden"), [(1400, "wide", "narrow"), (500, "narrow", "wide")])
def test_a_page_fits_its_window(folder: Path, tmp_path: Path, width: int, shown: str, hidden: str) -> None:
    assert CHROMIUM is not None
    measure = """<script>document.title = JSON.stringify({
        page: document.documentElement.scrollWidth, window: innerWidth,
        wide: [...document.querySelectorAll(".wide")].filter(part => part.offsetWidth).length,
        narrow: [...document.querySelectorAll(".narrow")].filter(part => part.offsetWidth).length,
        figures: [...document.querySelectorAll(".figures")].map(grid => {
            const ends = [...grid.children].map(figure => figure.getBoundingClientRect().right);
            return grid.getBoundingClientRect().right - Math.max(...ends);
        }),
    })</script></body>"""
    page = tmp_path / "page.html"
    page.write_text((folder / "report.html").read_text().replace("</body>", measure))
    size, profile = f"--window-size={width},900", f"--user-data-dir={tmp_path / 'profile'}"
    done = processes.run([CHROMIUM, *FLAGS, size, profile, "--dump-dom", page.as_uri()], timeout=60)
    assert done.returncode == 0, done.stderr
    found = re.search(r"<title>(.*)</title>", done.stdout)
    assert found is not None
    measured = json.loads(found[1])
    assert measured["page"] <= measured["window"] == width
    assert measured[shown] > 0 == measured[hidden]
    assert max(measured["figures"]) < 1, "figures reach from one side to the other"


def test_a_trace_with_a_speed_that_is_no_number_is_rejected(tmp_path: Path) -> None:
    trace = write_trace(tmp_path / "walk.csv")
    trace.write_text(trace.read_text().replace("5,0.5,", "5,fast,", 1))
    with pytest.raises(CheckpointError, match=r"walk\.csv: not every forward_velocity is a number"):
        report.write([trace], tmp_path / "page.html")
