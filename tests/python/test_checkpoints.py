"""Checkpoints that cannot be used: refused by name, and nothing is touched."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from .command_line import ITERATION, TINY, dappo_batch, dappo_batch_many, files

NEWEST = Path("checkpoints") / "00000004"


def truncate(run: Path) -> None:
    path = run / NEWEST / "policy.bpk"
    path.write_bytes(path.read_bytes()[:-100])


def flip(name: str) -> Callable[[Path], None]:
    def apply(run: Path) -> None:
        path = run / NEWEST / name
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 0x10
        path.write_bytes(data)

    return apply


def cut_manifest(run: Path) -> None:
    path = run / NEWEST / "manifest.json"
    path.write_text(path.read_text()[:60])


def edit_manifest(key: str, value: str) -> Callable[[Path], None]:
    def apply(run: Path) -> None:
        path = run / NEWEST / "manifest.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), key: value}))

    return apply


def remove(name: str) -> Callable[[Path], None]:
    return lambda run: (run / NEWEST / name).unlink()


def edit_config(*changes: tuple[str, str]) -> Callable[[Path], None]:
    """Make the configuration that of another run, as if the checkpoint had been copied into it."""

    def apply(run: Path) -> None:
        path = run / "config.toml"
        text = path.read_text()
        for old, new in changes:
            assert text.count(old) == 1
            text = text.replace(old, new)
        path.write_text(text)
        if any("robot" in old for old, _ in changes):
            # The run's copy of its robot would give the mistake away before.
            shutil.rmtree(run / "robot")

    return apply


# What is done to the run, the file that the message must name, and what it must say.
CASES: dict[str, tuple[Callable[[Path], None], str, str]] = {
    "truncated weights": (truncate, "00000004/policy.bpk", "expected"),
    "a bit flipped in the weights": (flip("value.bpk"), "00000004/value.bpk", "CRC-32"),
    "a bit flipped in the envs": (flip("envs.safetensors"), "00000004/envs.safetensors", "CRC-32"),
    "a bit flipped in the learner": (flip("learner.toml"), "00000004/learner.toml", "CRC-32"),
    "a file missing": (remove("policy_adam.bpk"), "00000004/policy_adam.bpk", "cannot be read"),
    "no manifest": (remove("manifest.json"), "00000004/manifest.json", "this is not a checkpoint"),
    "a truncated manifest": (cut_manifest, "00000004/manifest.json", "truncated or foreign"),
    "another format": (edit_manifest("format", "other 9"), "00000004/manifest.json", "`other 9`, expected `"),
    "another robot": (
        edit_config(('robot = "ant"', 'robot = "hexapod"'), ('reward = "gym"', 'reward = "paper"')),
        "00000004/manifest.json",
        "belongs to robot `ant`, expected `hexapod`",
    ),
    "an unaware policy": (
        edit_config(("observe_damage = true", "observe_damage = false")),
        "00000004",
        "length of an observation is 119, expected 111",
    ),
    "other networks": (
        edit_config(("hidden = [8]", "hidden = [9]")),
        "00000004/learner.toml",
        "[8], expected [9]",
    ),
    "another backend": (
        edit_config(('backend = "lanes"', 'backend = "mujoco"')),
        "00000004",
        "numbers each, this backend has 4 envs with",
    ),
    "another number of envs": (
        edit_config(("num_envs = 4", "num_envs = 5")),
        "00000004",
        "has 4 entries, expected 5",
    ),
    "no checkpoint left": (
        lambda run: shutil.rmtree(run / "checkpoints"),
        "checkpoints",
        "holds no checkpoint",
    ),
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train once."""
    run = tmp_path_factory.mktemp("checkpoints") / "run"
    dappo_batch("train", "--run", run, "--steps", str(4 * ITERATION), *TINY)
    return run


@pytest.fixture(scope="module")
def refusals(run: Path) -> dict[str, tuple[int, str, bool]]:
    """Resume a copy of the run for each case, all in one process.

    A case gives the exit code, the message, and whether a file has changed.
    """
    copies = {name: run.with_name(f"copy{index}") for index, name in enumerate(CASES)}
    before = {}
    for name, copy in copies.items():
        shutil.copytree(run, copy)
        CASES[name][0](copy)
        before[name] = files(copy)
    steps = str(8 * ITERATION)
    results = dappo_batch_many(
        *(("train", "--resume", copy, "--steps", steps, "--json") for copy in copies.values())
    )
    return {
        name: (code, err, files(copies[name]) != before[name])
        for name, (code, _, err) in zip(copies, results, strict=True)
    }


@pytest.mark.parametrize("name", CASES)
def test_a_checkpoint_that_cannot_be_used_is_rejected_by_name(
    name: str, refusals: dict[str, tuple[int, str, bool]]
) -> None:
    code, message, changed = refusals[name]
    _, file, reason = CASES[name]
    assert code == 1, message
    assert message.splitlines()[-1].startswith("error: ")
    assert file in message
    assert reason in message
    assert not changed, "a refused resume must leave the run folder as it is"


def test_the_evaluation_refuses_a_damaged_checkpoint_and_training_resumes_from_the_one_before(
    run: Path, tmp_path: Path
) -> None:
    damaged, earlier = tmp_path / "damaged", tmp_path / "earlier"
    for copy in (damaged, earlier):
        shutil.copytree(run, copy)
    flip("policy.bpk")(damaged)
    shutil.rmtree(earlier / NEWEST)
    refused, resumed = dappo_batch_many(("evaluate", damaged), ("train", "--resume", earlier))
    assert refused[0] == 1
    assert "policy.bpk" in refused[2]
    assert "CRC-32" in refused[2]
    assert resumed[0] == 0
    names = sorted(path.name for path in (earlier / "checkpoints").iterdir())
    assert names == ["00000003", "00000004"]


def test_folders_that_are_no_checkpoints_are_neither_used_nor_counted_nor_removed(
    run: Path, tmp_path: Path
) -> None:
    copy = tmp_path / "copy"
    shutil.copytree(run, copy)
    checkpoints = copy / "checkpoints"
    shutil.copytree(copy / NEWEST, checkpoints / "1")
    for name in ("0", "00000000"):
        (checkpoints / name).mkdir()
        (checkpoints / name / "notes.txt").write_text("mine")
    # What a kill may have left of a checkpoint that was being removed, and of one that was being written.
    (checkpoints / "00000001").mkdir()
    shutil.copy(copy / NEWEST / "policy.bpk", checkpoints / "00000001")
    (checkpoints / ".00000005.0123456789abcdef.tmp").mkdir()
    shutil.copy(copy / NEWEST / "policy.bpk", checkpoints / ".00000005.0123456789abcdef.tmp")
    ((code, _, err),) = dappo_batch_many(("train", "--resume", copy, "--steps", str(6 * ITERATION)))
    assert code == 0, err
    left = sorted(path.name for path in checkpoints.iterdir())
    keep = 2
    ours = [name for name in left if len(name) == 8 and name != "00000000"]
    assert ours[-1] == "00000006", "the run went on from its own newest checkpoint"
    assert len(ours) == keep
    assert [name for name in left if name not in ours] == ["0", "00000000", "1"]
    for name in ("0", "00000000"):
        assert (checkpoints / name / "notes.txt").read_text() == "mine"
