"""`dappo-batch report`: one page that needs nothing else, and its figures as files."""

from __future__ import annotations

import re
import resource
import shutil
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from dappo_batch import CheckpointError, ConfigError, MissingExtraError, load_run, report
from dappo_batch.report.figures.adaptation import shares
from dappo_batch.report.figures.evaluation import means_of_groups
from dappo_batch.report.learners import learners
from dappo_batch.report.sources import read

from .. import processes
from .command_line import dappo_batch_many, files
from .run_folders import write_adaptation, write_diagnoser, write_run, write_sweep, write_trace

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None
)
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update", "--enable-logging=stderr"),
)
VOID = {"br", "hr", "img", "input", "link", "meta"}


class Page(HTMLParser):
    """Read a page, and check that every element is closed and every anchor unique."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.text = path.read_text(encoding="utf-8")
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.headings: list[str] = []
        self.cells: list[str] = []
        self.feed(self.text)
        self.close()
        assert self.open == []
        assert len(self.ids) == len(set(self.ids))

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        for name, value in attrs:
            if name == "id":
                self.ids.append(str(value))
            elif name in ("href", "xlink:href", "src"):
                self.links.append(str(value))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "h2":
            self.headings.append(data)
        elif self.open and self.open[-1] == "td":
            self.cells.append(data)


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
        "ant: DA-PPO and PPO-Unaware",
        "ant: damage classes",
        "Damage in mid-walk",
        "Walks",
        "Table 1: accuracy of the diagnosis",
        "Diagnosis",
        "Throughput",
        "Configuration and versions",
    ]
    assert "<h1>Runs &lt;of&gt; $June$ &amp; July</h1>" in page.text
    # Means over 4 classes and 2 seeds: (10 + 11) / 8 and (7 + 8) / 8; ahead in 3 classes.
    for cell in ("2.6", "1.9", "+40.0 %", "3 of 4", "75.00 %", "lanes", "diagnosed broken (0.97)"):
        assert cell in page.cells, cell
    assert "gamma = 0.99" in page.text


def test_a_page_needs_nothing_else(folder: Path) -> None:
    page = Page(folder / "report.html")
    assert all(link.startswith(("#", "data:")) for link in page.links)
    assert {link[1:] for link in page.links if link.startswith("#")} <= set(page.ids)
    assert "http" not in page.text.replace("http-equiv", "")
    assert not re.search(r"url\((?!#)|@import", page.text)


def test_figures_follow_light_and_dark(folder: Path) -> None:
    text = (folder / "report.html").read_text()
    drawings = re.findall(r"<svg.*?</svg>", text, re.DOTALL)
    assert len(drawings) == text.count("<figure>") > 10
    for drawing in drawings:
        assert "var(--ink)" in drawing
        # Bitmaps hold letters and digits that look like anything.
        assert not re.search(r"#[0-9a-f]{6}\b", re.sub(r'"data:[^"]*"', "", drawing))
    assert "@media (prefers-color-scheme: dark)" in text
    for name in set(re.findall(r"var\((--[a-z0-9-]+)\)", text)):
        assert len(re.findall(rf"{name}: #", text)) == 3, "light, dark by choice, dark by the system"


def test_every_figure_is_written_as_png_and_svg(folder: Path) -> None:
    written = sorted(path.name for path in (folder / "figures").iterdir())
    names = sorted({name.rpartition(".")[0] for name in written})
    assert written == sorted(f"{name}.{kind}" for name in names for kind in ("png", "svg"))
    assert len(names) == (folder / "report.html").read_text().count("<figure>")
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
    assert Page(tmp_path / "one.html").headings == ["Walks", "Diagnosis"], "nothing about runs"


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
    means = {name: values.tolist() for name, values in means_of_groups(learner).items()}
    assert means == {"none": [4.0, 5.0], "D1": [3.0, 3.0], "D2": [1.5, 1.5], "all": [2.5, 2.75]}


def test_shares_of_the_oracle_leave_the_healthy_robot_out(folder: Path) -> None:
    table = load_run(folder / "aware0").adaptation
    assert table is not None
    assert shares(table) == {"adapted": 0.9, "unadapted": 0.5}


def test_a_path_that_is_nothing_known_is_named_and_nothing_is_written(folder: Path, tmp_path: Path) -> None:
    foreign, young = tmp_path / "foreign.csv", tmp_path / "young"
    foreign.write_text("a,b\n1,2\n")
    write_run(young, forward_rewards=[])
    out = tmp_path / "out"
    out.mkdir()
    arguments = ("--out", out / "page.html", "--figures", out / "figures")
    expected = {
        tmp_path / "nowhere": "nowhere does not exist; expected a run folder",
        tmp_path: "has neither config.toml nor table1.csv; expected a run folder",
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


def test_a_report_of_nothing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="there is nothing to report"):
        report.write([], tmp_path / "report.html")


def test_a_table_that_is_cut_short_is_refused(tmp_path: Path) -> None:
    trace = write_trace(tmp_path / "walk.csv")
    trace.write_text(trace.read_text()[:-10])
    with pytest.raises(CheckpointError, match=r"walk.csv: row 61 has \d entries, expected 5"):
        read([trace])
    confusion = write_diagnoser(tmp_path / "diagnoser") / "eval" / "test.confusion.csv"
    confusion.write_text("true\\named,healthy,broken\nhealthy,2,0\n")
    with pytest.raises(CheckpointError, match="rows and columns name other classes"):
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


def test_without_matplotlib_the_message_says_what_to_install(
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


def test_a_trace_with_a_speed_that_is_no_number_is_refused(tmp_path: Path) -> None:
    trace = write_trace(tmp_path / "walk.csv")
    trace.write_text(trace.read_text().replace("5,0.5,", "5,fast,", 1))
    with pytest.raises(CheckpointError, match=r"walk\.csv: not every forward_velocity is a number"):
        report.write([trace], tmp_path / "page.html")
