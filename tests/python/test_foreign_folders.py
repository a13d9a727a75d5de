"""Folders from untrusted sources: nothing outside of them is read or written, and nothing hangs."""

from __future__ import annotations

import json
import os
import re
import shutil
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import dappo_batch
from dappo_batch import CheckpointError, ConfigError, Controller, DappoError, Policy, load_run
from dappo_batch.report.sources import read
from dappo_batch.sweeps import sweep

from .command_line import ITERATION, files
from .command_line import dappo_batch as command_line
from .run_folders import write_diagnoser, write_run, write_sweep

PRECIOUS = "precious data\n"
NEWEST = "checkpoints/00000002"


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Make a run, a dataset, a diagnoser and an export."""
    root = tmp_path_factory.mktemp("made")
    settings = {"horizon": 16, "env.max_episode_steps": 20, "ppo.hidden": [8], "evaluation.episodes": 1}
    settings |= {"damage.max_damaged_limbs": 1, "checkpoint.every": 1, "checkpoint.keep": 2}
    dappo_batch.train(root / "run", num_envs=4, threads=1, total_steps=2 * ITERATION, set=settings)
    windows = {"preset": "residual", "rollouts": 4, "timesteps": 3, "threads": 1}
    dappo_batch.collect_pairs(root / "run", root / "pairs", **windows)
    network = {"epochs": 1, "embedding": 8, "lstm": 4, "hidden": [8]}
    dappo_batch.train_diagnoser(root / "pairs", root / "diagnoser", threads=1, set=network)
    # A resumed training has something left to do.
    config = root / "diagnoser" / "config.toml"
    config.write_text(config.read_text().replace("epochs = 1\n", "epochs = 2\n"))
    command_line("export", root / "run", "--diagnoser", root / "diagnoser", "--out", root / "export")
    return root


@pytest.fixture
def folders(made: Path, tmp_path: Path) -> Path:
    """Copy them all, and put a file next to them that must not change."""
    root = tmp_path / "folders"
    shutil.copytree(made, root)
    (tmp_path / "victim").write_text(PRECIOUS)
    return root


def victim(folders: Path) -> Path:
    return folders.parent / "victim"


def resume(folders: Path) -> None:
    dappo_batch.resume(folders / "run", total_steps=3 * ITERATION, threads=1)


def evaluate(folders: Path) -> None:
    dappo_batch.evaluate(folders / "run", threads=1)


def controller(folders: Path) -> None:
    Controller.from_export(folders / "export")


def export(folders: Path) -> None:
    dappo_batch.export(folders / "run", folders / "policy")


def diagnose(folders: Path) -> None:
    dappo_batch.evaluate_diagnoser(folders / "diagnoser", data=[folders / "pairs"], threads=1)


def train_diagnoser(folders: Path) -> None:
    arguments = {"data": folders / "pairs", "resume": folders / "diagnoser"}
    dappo_batch._core.run_command("train_diagnoser", arguments, "")


def collect(folders: Path) -> None:
    windows: dict[str, Any] = {"preset": "residual", "rollouts": 5, "timesteps": 3, "threads": 1}
    dappo_batch.collect_pairs(folders / "run", folders / "pairs", **windows)


def put(path: Path, kind: str, target: Path) -> None:
    """Put something else in the place of a file."""
    path.unlink(missing_ok=True)
    if kind == "link":
        path.symlink_to(target)
    elif kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    else:
        path.symlink_to("/dev/zero")


# What is written, and by what.
WRITTEN: list[tuple[str, Callable[[Path], None]]] = [
    ("run/lock", resume),
    ("run/config.toml", resume),
    ("run/meta.json", resume),
    ("run/metrics.jsonl", resume),
    ("run/metrics.csv", resume),
    ("run/events.out.tfevents.metrics", resume),
    ("run/eval/per_class.csv", evaluate),
    ("pairs/dataset.json", collect),
    ("pairs/rollouts-000000.npy", collect),
    ("diagnoser/lock", train_diagnoser),
    ("diagnoser/metrics.jsonl", train_diagnoser),
    ("diagnoser/config.toml", train_diagnoser),
    ("diagnoser/eval/pairs.json", diagnose),
]


@pytest.mark.parametrize(("name", "command"), WRITTEN, ids=[name for name, _ in WRITTEN])
def test_a_link_in_the_place_of_a_file_is_rejected_or_replaced_and_never_followed(
    name: str, command: Callable[[Path], None], folders: Path
) -> None:
    put(folders / name, "link", victim(folders))
    try:
        command(folders)
    except CheckpointError as error:
        assert "it is a symbolic link" in str(error)  # noqa: PT017 - some are replaced instead
        assert Path(name).name in str(error)  # noqa: PT017
    assert victim(folders).read_text() == PRECIOUS


FOLDERS: list[tuple[str, Callable[[Path], None]]] = [
    ("run/checkpoints", resume),
    ("run/eval", evaluate),
    ("diagnoser/checkpoints", train_diagnoser),
    ("diagnoser/model", train_diagnoser),
    ("diagnoser/eval", diagnose),
]


@pytest.mark.parametrize(("name", "command"), FOLDERS, ids=[name for name, _ in FOLDERS])
def test_a_link_in_the_place_of_a_folder_is_never_written_to(
    name: str, command: Callable[[Path], None], folders: Path
) -> None:
    elsewhere = folders.parent / "elsewhere"
    shutil.move(folders / name, elsewhere)
    (folders / name).symlink_to(elsewhere)
    before = files(elsewhere)
    with pytest.raises(CheckpointError, match=r"symbolic link, expected a folder"):
        command(folders)
    assert files(elsewhere) == before


READ_FOLDERS: list[tuple[str, Callable[[Path], None]]] = [
    ("run/eval", export),
    ("run/checkpoints", export),
    ("run/robot", export),
    ("diagnoser/model", diagnose),
]


@pytest.mark.parametrize(("name", "command"), READ_FOLDERS, ids=[name for name, _ in READ_FOLDERS])
def test_a_link_in_the_place_of_a_folder_is_never_read_from(
    name: str, command: Callable[[Path], None], folders: Path
) -> None:
    elsewhere = folders.parent / "elsewhere"
    shutil.move(folders / name, elsewhere)
    (folders / name).symlink_to(elsewhere)
    with pytest.raises(CheckpointError, match=r"symbolic link, expected a folder"):
        command(folders)


def test_a_link_in_a_new_run_folder_is_not_followed(tmp_path: Path) -> None:
    (tmp_path / "victim").write_text(PRECIOUS)
    run = tmp_path / "run"
    run.mkdir()
    for name in ("config.toml", "meta.json", "metrics.jsonl", "metrics.csv"):
        (run / name).symlink_to(tmp_path / ("victim" if name != "config.toml" else "nowhere"))
    with pytest.raises(CheckpointError, match=r"metrics.jsonl.* it is a symbolic link"):
        dappo_batch.train(
            run, num_envs=4, threads=1, total_steps=ITERATION, set={"horizon": 16, "ppo.hidden": [8]}
        )
    assert (tmp_path / "victim").read_text() == PRECIOUS
    assert not (tmp_path / "nowhere").exists()


# What is read, and by what.
READ: list[tuple[str, Callable[[Path], None]]] = [
    ("run/config.toml", evaluate),
    (f"run/{NEWEST}/manifest.json", evaluate),
    (f"run/{NEWEST}/policy.bpk", evaluate),
    (f"run/{NEWEST}/learner.toml", evaluate),
    ("pairs/dataset.json", diagnose),
    ("pairs/rollouts-000000.npy", diagnose),
    ("diagnoser/config.toml", diagnose),
    ("diagnoser/model/diagnoser.toml", diagnose),
    ("diagnoser/model/weights.bpk", diagnose),
    ("export/export.json", controller),
    ("export/policy.safetensors", controller),
    ("export/config.toml", controller),
]


@pytest.mark.parametrize("kind", ["pipe", "device", "folder"])
@pytest.mark.parametrize(("name", "command"), READ, ids=[name for name, _ in READ])
def test_what_is_no_regular_file_is_rejected_at_once(
    name: str, command: Callable[[Path], None], kind: str, folders: Path
) -> None:
    put(folders / name, kind, victim(folders))
    with pytest.raises(
        DappoError, match=r"it is (a named pipe|a symbolic link|a folder|no run folder)"
    ) as error:
        command(folders)
    assert Path(name).name in str(error.value)


@pytest.mark.parametrize("kind", ["pipe", "device"])
def test_reports_and_runs_refuse_what_is_no_regular_file(kind: str, tmp_path: Path) -> None:
    for number, (write, name) in enumerate(
        [
            (write_run, "config.toml"),
            (write_run, "metrics.jsonl"),
            (write_run, "meta.json"),
            (write_run, "eval/per_class.csv"),
            (write_diagnoser, "config.toml"),
            (write_diagnoser, "eval/test.confusion.csv"),
            (write_diagnoser, "eval/test.json"),
            (write_sweep, "table1.csv"),
        ]
    ):
        path = write(tmp_path / str(number))
        put(path / name, kind, tmp_path / "nowhere")
        with pytest.raises(CheckpointError, match=r"it is a (named pipe|symbolic link)"):
            read([path])
        if write is write_run:
            with pytest.raises(CheckpointError, match=Path(name).name):
                load_run(path)


def test_a_file_that_only_claims_to_be_large_takes_no_memory(folders: Path, tmp_path: Path) -> None:
    for name in ("run/metrics.jsonl", f"run/{NEWEST}/learner.toml", "export/policy.safetensors"):
        os.truncate(folders / name, 1 << 42)
    with pytest.raises(CheckpointError, match=r"metrics.jsonl.*more than the \d+ bytes"):
        load_run(folders / "run")
    with pytest.raises(CheckpointError, match=r"learner\.toml"):
        Policy.load(folders / "run")
    with pytest.raises(CheckpointError, match=r"policy\.safetensors"):
        controller(folders)
    # The manifest may have the same wrong size.
    manifest = json.loads((folders / "run" / NEWEST / "manifest.json").read_text())
    for file in manifest["files"]:
        file["bytes"] = (folders / "run" / NEWEST / file["name"]).stat().st_size
    (folders / "run" / NEWEST / "manifest.json").write_text(json.dumps(manifest))
    with pytest.raises(CheckpointError, match=r"learner.toml.*expected at most"):
        Policy.load(folders / "run")


def relist(folder: Path) -> None:
    """Bring a manifest up to date with files that were changed: a sender can do that as well."""
    path = folder / "manifest.json"
    manifest = json.loads(path.read_text())
    for file in manifest["files"]:
        data = (folder / file["name"]).read_bytes()
        file |= {"bytes": len(data), "crc32": zlib.crc32(data)}
    path.write_text(json.dumps(manifest))


@pytest.mark.parametrize(
    "name", ["/dev/zero", "../../../../../../../../etc/passwd", "../00000001/envs.safetensors", ".."]
)
def test_lists_name_files_of_their_own_folder(name: str, folders: Path) -> None:
    path = folders / "run" / NEWEST / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["files"].append({"name": name, "bytes": 1, "crc32": 1})
    path.write_text(json.dumps(manifest))
    path = folders / "export" / "export.json"
    header = json.loads(path.read_text())
    header["files"][name] = {"bytes": 1, "sha256": "0" * 64}
    path.write_text(json.dumps(header))
    for command in (evaluate, controller):
        with pytest.raises(
            CheckpointError, match=f"it lists `{re.escape(name)}`, expected names of files in its"
        ):
            command(folders)


def test_a_file_that_is_not_listed_is_rejected(folders: Path) -> None:
    path = folders / "run" / NEWEST / "manifest.json"
    manifest = json.loads(path.read_text())
    manifest["files"] = [file for file in manifest["files"] if file["name"] != "envs.safetensors"]
    path.write_text(json.dumps(manifest))
    before = files(folders)
    with pytest.raises(CheckpointError, match=r"envs.safetensors: manifest.json does not list it"):
        resume(folders)
    assert files(folders) == before
    (folders / "run" / NEWEST / "envs.safetensors").unlink()
    with pytest.raises(CheckpointError, match=r"envs.safetensors: manifest.json does not list it"):
        resume(folders)
    (folders / "export" / "notes.txt").write_text("mine")
    with pytest.raises(CheckpointError, match=r"notes.txt: export.json does not list it"):
        controller(folders)
    (folders / "diagnoser" / "model" / "notes.txt").write_text("mine")
    with pytest.raises(CheckpointError, match=r"notes.txt: diagnoser.toml does not list it"):
        diagnose(folders)
    # An export that contains other files is not replaced.
    again = ("export", folders / "run", "--diagnoser", folders / "diagnoser", "--out", folders / "export")
    assert "notes.txt is not a file of an export" in command_line(*again, code=1)[1]
    assert (folders / "export" / "notes.txt").read_text() == "mine"


NUMBER = r"-?[\d.]+(e-?\d+)?"
# What the file of the learner is changed to, and what is said of it.
LEARNERS = {
    "squares shorter than means": (
        rf"squares = \[{NUMBER}, ",
        "squares = [",
        "squares of the normaliser has",
    ),
    "means shorter than squares": (rf"mean = \[{NUMBER}, ", "mean = [", "squares of the normaliser has"),
    "a mean that is no number": (rf"mean = \[{NUMBER}", "mean = [nan", "mean of observation entry 0 is NaN"),
    "a mean beyond f32": (rf"mean = \[{NUMBER}", "mean = [1e39", "mean of observation entry 0 is inf"),
    "infinite squares": (rf"squares = \[{NUMBER}", "squares = [inf", "squares of observation entry 0 is inf"),
    "negative squares": (rf"squares = \[{NUMBER}", "squares = [-1.0", "squares is -1, expected sums"),
    "a negative count": (r"count = \d+", "count = -1", "learner.toml"),
    "a count beyond f64": (r"count = \d+", "count = 9223372036854775807", "at most 2^53 rows"),
    "a code longer than a row": (r"code_length = \d+", "code_length = 9223372036854775807", "damage code is"),
    "a code of another length": (r"code_length = \d+", "code_length = 7", "length of the damage code is 7"),
    "a factor that is no number": (
        rf"code_scale = {NUMBER}",
        "code_scale = nan",
        "factor of the damage code",
    ),
    "rows beyond all memory": (
        r"value_batch_rows = \d+",
        "value_batch_rows = 9223372036854775807",
        "beyond all memory",
    ),
    "more rows than the file holds": (
        r"value_batch_rows = \d+",
        "value_batch_rows = 1000000000000",
        r"value_batch.bpk: it has",
    ),
    "other rows than the file holds": (r"value_batch_rows = \d+", "value_batch_rows = 63", "value_batch.bpk"),
    "another length of an action": (r"action_dim = \d+", "action_dim = 9", "length of an action is 9"),
    "a penalty that is no number": (rf"kl_coef = {NUMBER}", "kl_coef = nan", "kl_coef is NaN"),
    "a learning rate below 0": (rf"lr_factor = {NUMBER}", "lr_factor = -1.0", "lr_factor is -1"),
    "a seed that is no number": (r'seed = "\d+"', 'seed = "x"', "learner.toml"),
}


@pytest.mark.parametrize("case", LEARNERS)
def test_a_learner_whose_numbers_do_not_fit_is_rejected_before_it_is_used(case: str, folders: Path) -> None:
    pattern, replacement, message = LEARNERS[case]
    path = folders / "run" / NEWEST / "learner.toml"
    text, count = re.subn(pattern, replacement, path.read_text(), count=1)
    assert count == 1
    path.write_text(text)
    relist(path.parent)
    for command in (lambda _: Policy.load(folders / "run"), resume):
        with pytest.raises(CheckpointError, match=re.escape(message)):
            command(folders)


def test_moments_of_other_shapes_are_rejected(folders: Path) -> None:
    newest = folders / "run" / NEWEST
    shutil.copy(newest / "value_adam.bpk", newest / "policy_adam.bpk")
    relist(newest)
    with pytest.raises(
        CheckpointError, match=r"policy_adam.bpk.*(belongs to no parameter|lacks a moment|shape)"
    ):
        resume(folders)


@pytest.mark.parametrize("name", [b"run\xff", b"caf\xc3\xa9", b"new\nline"])
def test_paths_are_bytes(name: bytes, tmp_path: Path) -> None:
    root = os.fsencode(tmp_path) + b"/"
    settings = {"horizon": 16, "env.max_episode_steps": 20, "ppo.hidden": [8], "evaluation.episodes": 1}
    settings |= {"damage.max_damaged_limbs": 1}
    run = dappo_batch.train(root + name, num_envs=4, threads=1, total_steps=ITERATION, set=settings)
    assert os.fsencode(run.path) == root + name
    assert len(load_run(root + name).metrics["iteration"]) == 1
    Policy.load(root + name)
    # The same path as Python decodes it.
    report = dappo_batch.evaluate(os.fsdecode(root + name), threads=1, episodes=1)
    assert len(report.runs) == 1
    windows: dict[str, Any] = {"rollouts": 2, "timesteps": 3, "threads": 1}
    parts = dappo_batch.collect_pairs(root + name, root + b"pairs" + name, **windows)
    assert [os.fsencode(part.parent) for part in parts] == [root + b"pairs" + name]
    network = {"epochs": 1, "embedding": 8, "lstm": 4, "hidden": [8]}
    dappo_batch.train_diagnoser(root + b"pairs" + name, root + b"net" + name, threads=1, set=network)
    (tested,) = dappo_batch.evaluate_diagnoser(root + b"net" + name, data=[root + b"pairs" + name], threads=1)
    assert tested.summary.windows == 2 * len(tested.classes)
    if name == b"run\xff":
        with pytest.raises(ConfigError, match="has no name in UTF-8"):
            read([root + name])


def test_command_lines_are_bytes_as_well(
    made: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = os.fsdecode(os.fsencode(tmp_path) + b"/run\xff")
    assert dappo_batch._core.run_cli(["train", "--resume", run, "--threads", "1"]) == 1
    assert "is not a run folder" in capfd.readouterr().err
    shutil.copytree(made / "run", run)
    assert dappo_batch._core.run_cli(["evaluate", run, "--threads", "1"]) == 0
    assert dappo_batch._core.run_cli(["train", os.fsdecode(b"--r\xff")]) == 2
    assert dappo_batch._core.run_cli(["report", run, "--out", run]) == 1
    assert "error: " in capfd.readouterr().err
    page = os.fsdecode(os.fsencode(tmp_path) + b"/page\xff")
    assert dappo_batch._core.run_cli(["report", str(made / "run"), "--out", page]) == 0
    assert "page\ufffd (" in capfd.readouterr().out
    assert os.path.getsize(page) > 0


def test_a_sweep_does_not_follow_links(tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    out.mkdir()
    (tmp_path / "victim").write_text(PRECIOUS)
    (out / ".seed=0.lock").symlink_to(tmp_path / "victim")
    (cell,) = sweep({}, {"seed": [0]}, out)
    assert "cannot be locked" in (cell.error or "")
    (out / "sweep.json").unlink()
    (out / "sweep.json").symlink_to(tmp_path / "victim")
    with pytest.raises(CheckpointError, match="it is a symbolic link"):
        sweep({}, {"seed": [0]}, out)
    assert (tmp_path / "victim").read_text() == PRECIOUS
