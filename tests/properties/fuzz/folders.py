"""Runs, diagnosers, datasets and exports with changed files."""

from __future__ import annotations

import os
from pathlib import Path
from random import Random

import numpy as np

import dappo_batch

from . import mutate
from .files import json_text, toml_text
from .room import Room, sign

NARROW = ("--threads", "1")


def _damage(rng: Random, folder: Path) -> None:
    """Change files of a folder; most of the time the checksums fit again."""
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    for path in rng.sample(files, min(len(files), rng.choice((1, 1, 1, 2)))):
        if not path.is_file():  # any more
            continue
        _damage_file(rng, path, files)
    if rng.random() < 0.75:
        sign(folder)


def _damage_file(rng: Random, path: Path, files: list[Path]) -> None:
    kind = rng.randrange(20)
    if kind == 0:
        path.unlink()
    elif kind == 1:
        path.write_bytes(b"")
    elif kind == 2:
        path.unlink()
        _put_no_file(rng, path)
    elif kind == 3 and (other := rng.choice(files)).is_file():
        path.write_bytes(other.read_bytes())
    elif kind == 4:
        path.rename(
            path.with_name(rng.choice(("0", "1", "99999999", "x", path.name + ".tmp", "config.toml")))
        )
    elif path.suffix in (".json", ".toml", ".csv", ".xml", ".jsonl") and kind < 17:
        text = path.read_text(encoding="utf-8", errors="replace")
        change = {".json": json_text, ".toml": toml_text}.get(path.suffix, mutate.text)
        try:
            text = change(rng, text)
        except (ValueError, RecursionError):  # a copy of another file, or changed before
            text = mutate.text(rng, text)
        path.write_bytes(text.encode("utf-8", "surrogatepass"))
    else:
        path.write_bytes(mutate.raw(rng, path.read_bytes()))


def _put_no_file(rng: Random, path: Path) -> None:
    """Replace a file by something that cannot be read, such as a pipe."""
    kind = rng.randrange(5)
    if kind == 0:
        path.mkdir()
    elif kind == 1:
        os.mkfifo(path)
    else:
        path.symlink_to(("/dev/zero", path.name, "missing")[kind - 2])


def run_folder(rng: Random, room: Room) -> None:
    """Read, resume and evaluate a run, and create a controller from it."""
    run = room.copy("run")
    _damage(rng, run)
    use = rng.randrange(10)
    if use <= 2:
        room.call(dappo_batch.load_run, run)
    elif use <= 5:
        policy = room.call(dappo_batch.Policy.load, run)
        actions = room.call(policy.act, np.zeros((2, policy.obs_dim), np.float32), damage_class=None)
        assert actions.shape == (2, policy.action_dim), "the shape of the actions"
    elif use == 6:
        room.command(["evaluate", "run", *NARROW, *(["--json"] if rng.random() < 0.5 else [])])
    elif use == 7:
        room.stopped_command(["train", "--resume", "run", "--steps", "32", *NARROW])
    elif use == 8:
        _walk(room, room.call(dappo_batch.Controller, run, diagnoser=room.base / "diagnoser"))
    else:
        room.command(["export", "run", "--diagnoser", str(room.base / "diagnoser"), "--out", "out"])


def diagnoser_folder(rng: Random, room: Room) -> None:
    """Load, evaluate and resume a diagnoser."""
    diagnoser = room.copy("diagnoser")
    _damage(rng, diagnoser)
    use = rng.randrange(8)
    if use <= 3:
        loaded = room.call(dappo_batch.Diagnoser.load, diagnoser, expert=room.base / "run")
        steps = loaded.timesteps
        obs = np.zeros((1, steps + 1, loaded.obs_dim), np.float32)
        obs[:, :, 1] = 1.0  # an upright robot
        room.call(loaded.diagnose, obs, np.zeros((1, steps, loaded.action_dim), np.float32))
    elif use <= 5:
        _walk(room, room.call(dappo_batch.Controller, room.base / "run", diagnoser=diagnoser))
    elif use == 6:
        room.command(["diagnose", "test", "diagnoser", "--data", str(room.base / "pairs"), *NARROW])
    else:
        room.stopped_command(
            ["diagnose", "train", str(room.base / "pairs"), "--resume", "diagnoser", *NARROW]
        )


def dataset(rng: Random, room: Room) -> None:
    """Train and evaluate a diagnoser on a dataset, and extend it."""
    pairs = room.copy("pairs")
    _damage(rng, pairs)
    use = rng.randrange(4)
    if use <= 1:
        sizes = ("epochs=1", "embedding=3", "lstm=3", "hidden=[3]")
        room.stopped_command(["diagnose", "train", "pairs", "--out", "out", *NARROW, "--set", *sizes])
    elif use == 2:
        room.command(["diagnose", "test", str(room.base / "diagnoser"), "--data", "pairs", *NARROW])
    else:
        windows = ("--preset", "residual", "--rollouts", "5", "--timesteps", "3", "--onset", "0-2")
        argv = ("diagnose", "collect", str(room.base / "run"), *windows, "--delay", "0-1", "--out", "pairs")
        room.stopped_command([*argv, *NARROW])


def export_folder(rng: Random, room: Room) -> None:
    """Control robots from an export."""
    export = room.copy("export")
    _damage(rng, export)
    _walk(room, room.call(dappo_batch.Controller.from_export, export, num_robots=2))


def report(rng: Random, room: Room) -> None:
    """Draw changed runs, diagnosers and traces."""
    name = rng.choice(("run", "diagnoser", "trace.csv"))
    path = room.copy(name)
    if path.is_dir():
        _damage(rng, path)
    else:
        path.write_text(mutate.text(rng, path.read_text()))
    room.command(["report", name, "--out", "page.html"])


def _walk(room: Room, controller: dappo_batch.Controller) -> None:
    robots = controller.num_robots
    for _ in range(3):
        obs = np.zeros((robots, controller.obs_dim), np.float32)
        actions = room.call(controller.act, obs, np.zeros(robots))
        assert np.isfinite(actions).all(), "an action is not finite"
