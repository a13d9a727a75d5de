"""`dappo-batch render` and `adapt --video`: films of real walks, where an OpenGL works."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import time
from pathlib import Path

import av
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

from .. import processes
from .command_line import TINY, dappo_batch_many, start
from .command_line import dappo_batch as run

ONSET, STEPS = 4, 9
CAPTION = 90  # rows from the top in which the captions of a GIF lie


@pytest.fixture(scope="module")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train a tiny policy of each robot, and a diagnoser."""
    root = tmp_path_factory.mktemp("render")
    pairs = ("--preset", "residual", "--delay", "3-8", "--rollouts", "4", "--out", root / "pairs")
    done = dappo_batch_many(
        ("train", *TINY, "--steps", "64", "--run", root / "ant"),
        ("train", *TINY, "--robot", "hexapod", "--healthy", "--steps", "64", "--run", root / "hexapod"),
        ("diagnose", "collect", root / "ant", *pairs),
        (
            "diagnose",
            "train",
            root / "pairs",
            "--timesteps",
            "5",
            "--out",
            root / "diagnoser",
            "--set",
            "epochs=1",
        ),
    )
    assert [code for code, _, _ in done] == [0] * len(done), done
    return root


def adapt(parts: Path, *more: str | Path) -> tuple[str | Path, ...]:
    walk = ("--damage", "missing_toe@1", "--at", "10", "--episodes", "2")
    return ("adapt", parts / "ant", "--diagnoser", parts / "diagnoser", *walk, *more)


def decoded(path: Path) -> list[tuple[float, NDArray[np.uint8]]]:
    with av.open(str(path)) as file:
        return [(float(frame.time or 0), frame.to_ndarray(format="rgb24")) for frame in file.decode(video=0)]


def red(picture: NDArray[np.uint8]) -> int:
    """Return how many pixels below the caption have the colour of damage."""
    below = picture[CAPTION:].astype(np.float64)
    # The trunk is orange: seven tenths as much green as red.
    return int(((below[..., 0] > 100) & (below[..., 1:].max(axis=2) < 0.4 * below[..., 0])).sum())


@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize(
    ("robot", "name", "step_seconds"), [("ant", "lanes", 0.05), ("hexapod", "mujoco", 0.015)]
)
def test_limbs_are_red_from_the_step_on_in_which_the_damage_strikes(
    robot: str, name: str, step_seconds: float, parts: Path, tmp_path: Path
) -> None:
    path = tmp_path / "walk.gif"
    walk = ("--damage", "missing_toe@1", "--at", str(ONSET), "--steps", str(STEPS))
    run("render", parts / robot, *walk, "--backend", name, "--out", path)
    film = decoded(path)
    assert film[-1][1].shape == (360, 480, 3)
    for shown, picture in film:
        struck = shown >= ONSET * step_seconds - 1e-6
        assert (red(picture) > 50) == struck, shown


@pytest.mark.usefixtures("opengl")
def test_a_png_of_one_frame_shows_the_last_step_of_a_policy_or_a_controller(
    parts: Path, tmp_path: Path
) -> None:
    walks: dict[str, tuple[str | Path, ...]] = {
        "healthy": ("--damage", "healthy"),
        "damaged": ("--damage", "jammed_joint@0"),
        "controlled": ("--damage", "missing_toe@1", "--at", "2", "--diagnoser", parts / "diagnoser"),
    }
    paths = {name: tmp_path / f"{name}.png" for name in walks}
    commands = [
        ("render", parts / "ant", *walk, "--steps", "3", "--strip", "1", "--out", paths[name])
        for name, walk in walks.items()
    ]
    done = dappo_batch_many(*commands)
    assert done == [(0, "", f"{path}: frames 1, steps 3\n") for path in paths.values()]
    pictures = {name: decoded(path)[0][1] for name, path in paths.items()}
    assert pictures["healthy"].shape == (480, 640, 3)
    assert red(pictures["healthy"]) == 0
    assert red(pictures["damaged"]) > 50
    assert red(pictures["controlled"]) > 50


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
def test_a_terminal_shows_how_many_frames_are_drawn(parts: Path, tmp_path: Path) -> None:
    screen, terminal = os.openpty()
    path = tmp_path / "walk.gif"
    command = ("render", parts / "ant", "--steps", "5", "--out", path)
    process = processes.start([*processes.DAPPO_BATCH, *command], stderr=terminal)
    os.close(terminal)
    shown = b""
    # The end of a terminal without a writer is an error on Linux.
    with contextlib.suppress(OSError):
        while read := os.read(screen, 4096):
            shown += read
    os.close(screen)
    assert process.wait(timeout=60) == 0
    assert b"frame 6/6" in shown
    assert f"{path.name}: frames 6, steps 5".encode() in shown


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
def test_adapt_prints_the_same_with_and_without_a_video(parts: Path, tmp_path: Path) -> None:
    path = tmp_path / "walk.mp4"
    done = dappo_batch_many(adapt(parts, "--json"), adapt(parts, "--json", "--video", path))
    reports = [json.loads(out) for _, out, _ in done]
    for report in reports:
        del report["summary"]["decision_ms"]  # a time
    assert [code for code, _, _ in done] == [0, 0]
    assert reports[0] == reports[1]
    film = decoded(path)
    # An Ant's step is as long as a picture; the first state comes before the first step.
    assert 10 < len(film) <= 21
    assert film[1][0] - film[0][0] == pytest.approx(0.05)


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
def test_the_camera_of_a_video_of_adapt_is_the_one_that_is_given(parts: Path, tmp_path: Path) -> None:
    paths = [tmp_path / "left.png", tmp_path / "right.png"]
    for path in paths:
        run(*adapt(parts, "--video", path, "--camera", path.stem))
    left, right = (np.asarray(Image.open(path), np.int64) for path in paths)
    assert np.abs(left - right).mean() > 1.0


def test_where_nothing_can_be_drawn_the_numbers_are_printed_and_written_first(
    parts: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MUJOCO_GL", "disable")
    video, log = tmp_path / "walk.mp4", tmp_path / "trace.csv"
    out, err = run(*adapt(parts, "--json", "--video", video, "--log", log), code=1)
    assert json.loads(out)["summary"]["classes"][0]["name"] == "missing_toe@1"
    assert log.read_text().startswith("step,")
    assert "error: pictures need OpenGL, and no implementation works (disable:" in err
    assert [file.name for file in tmp_path.iterdir()] == ["trace.csv"]


@pytest.mark.slow
@pytest.mark.usefixtures("opengl")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_ends_the_drawing_at_once_and_leaves_no_half_of_a_file(
    number: signal.Signals, parts: Path, tmp_path: Path
) -> None:
    process = start("render", parts / "ant", "--steps", "300", "--out", tmp_path / "walk.mp4")
    deadline = time.monotonic() + 60
    while not list(tmp_path.iterdir()) and process.poll() is None:
        assert time.monotonic() < deadline
        time.sleep(0.01)
    process.send_signal(number)
    process.communicate(timeout=60)
    assert process.returncode == 130
    assert not list(tmp_path.iterdir())


def test_unusable_input_is_rejected_before_the_episode(parts: Path, tmp_path: Path) -> None:
    render_it = ("render", parts / "ant", "--out", tmp_path / "walk.mp4")
    expected = {
        adapt(parts, "--video", tmp_path / "walk.avi"): (1, "expected one of .mp4, .gif, .png"),
        adapt(parts, "--video", tmp_path / "walk.mp4", "--camera", "above"): (1, "'above'"),
        adapt(parts, "--camera", "left"): (2, "--video"),
        (*render_it, "--at", "9", "--steps", "9"): (1, "strike at step 9, but an episode has 9 steps"),
        (*render_it, "--damage", "missing_toe@7"): (1, "missing_toe@7"),
        (*render_it, "--camera", "top"): (
            1,
            "camera is 'top', expected auto, left, right, front, back, or a camera",
        ),
        (*render_it, "--strip", "0"): (2, "--strip"),
        (*render_it, "--strip", "65"): (1, "strip must be"),
        (*render_it, "--expert", parts / "ant"): (2, "--diagnoser"),
    }
    done = dappo_batch_many(*expected)
    for (code, _, err), (expected_code, reason) in zip(done, expected.values(), strict=True):
        assert code == expected_code
        assert reason in err
    assert not list(tmp_path.iterdir())


def test_a_window_without_a_screen_is_rejected_before_the_episode(
    parts: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    _, err = run("view", parts / "ant", code=1)
    assert "there is no screen to open a window on" in err
