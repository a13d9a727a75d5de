"""Pictures into files and back through other readers, and what is said where that cannot work."""

from __future__ import annotations

import contextlib
import importlib.util
import itertools
import struct
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import av
import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray
from PIL import Image

import dappo_batch
from dappo_batch import ConfigError, DappoError, MissingExtraError, render
from dappo_batch.render import RenderError, Walk, encoders, film, opengl, window
from dappo_batch.render.captions import Caption
from dappo_batch.render.lettering import letter
from dappo_batch.render.scene import RED, copy_class, painted, scene
from dappo_batch.render.scenery import with_scenery

Picture = NDArray[np.uint8]
WIDTH, HEIGHT = 96, 64
COLOURS = ((200, 40, 30), (30, 160, 60), (40, 60, 200))


def pictures() -> Iterator[Picture]:
    """Return twelve pictures: a third of each is in one of three colours, which move."""
    for index in range(12):
        picture = np.empty((HEIGHT, WIDTH, 3), np.uint8)
        for third in range(3):
            picture[:, third * 32 : (third + 1) * 32] = COLOURS[(third + index // 4) % 3]
        yield picture


def middles(picture: Picture) -> NDArray[np.int64]:
    """Return the colours in the middle of the thirds."""
    return picture[HEIGHT // 2, [16, 48, 80]].astype(np.int64)


def decoded(path: Path) -> tuple[list[Picture], list[float]]:
    """Read a film with FFmpeg; return its pictures and their times, s."""
    with av.open(str(path)) as file:
        read = [(frame.to_ndarray(format="rgb24"), float(frame.time or 0)) for frame in file.decode(video=0)]
    return [picture for picture, _ in read], [time for _, time in read]


def boxes(content: bytes) -> dict[str, bytes]:
    """Return the innermost boxes of an mp4 (ISO/IEC 14496-12) that a test asks for."""
    found, start = {}, 0
    while start + 8 <= len(content):
        size, kind = struct.unpack(">I4s", content[start : start + 8])
        name, body = kind.decode("latin1"), content[start + 8 : start + size]
        found |= {name: body}
        if name in ("moov", "trak", "mdia", "minf", "stbl"):
            found |= boxes(body)
        start += size
    return found


def test_an_mp4_has_the_pictures_in_their_order_at_their_times(tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    encoders.write_mp4(path, pictures(), 0.05)
    read, times = decoded(path)
    np.testing.assert_allclose(times, 0.05 * np.arange(12), atol=1e-6)
    for got, expected in zip(read, pictures(), strict=True):
        # H.264 halves the resolution of colours and rounds.
        np.testing.assert_allclose(middles(got), middles(expected), atol=12)


def test_an_mp4_is_h264_that_can_be_shown_while_it_loads(tmp_path: Path) -> None:
    path = tmp_path / "film.mp4"
    encoders.write_mp4(path, pictures(), 0.05)
    content = path.read_bytes()
    found = boxes(content)
    assert content.index(b"moov") < content.index(b"mdat")
    assert found["stsd"][12:16] == b"avc1"
    timescale, duration = struct.unpack(">II", found["mvhd"][12:20])
    assert duration / timescale == pytest.approx(0.6)
    assert [value >> 16 for value in struct.unpack(">II", found["tkhd"][-8:])] == [WIDTH, HEIGHT]


def test_a_gif_has_the_pictures_in_their_order_at_their_times_and_repeats(tmp_path: Path) -> None:
    path = tmp_path / "film.gif"
    encoders.write_gif(path, pictures(), 0.05)
    # Equal pictures in a row may be one that is shown for longer.
    read, times = decoded(path)
    expected = list(pictures())
    for got, time in zip(read, times, strict=True):
        np.testing.assert_allclose(middles(got), middles(expected[round(time / 0.05)]), atol=8)
    assert {round(time / 0.05) for time in times} >= {0, 4, 8}
    with Image.open(path) as file:
        assert file.info["loop"] == 0
        total = 0
        for index in range(getattr(file, "n_frames", 1)):
            file.seek(index)
            total += file.info["duration"]
    assert total == 600


@pytest.mark.parametrize(("count", "rows", "columns"), [(1, 1, 1), (4, 1, 4), (5, 2, 3), (12, 3, 4)])
def test_a_png_has_bit_identical_pictures_in_rows(
    count: int, rows: int, columns: int, tmp_path: Path
) -> None:
    path = tmp_path / "picture.png"
    encoders.write_png(path, itertools.islice(pictures(), count))
    (read,), _ = decoded(path)
    gap = 4
    assert read.shape == (rows * (HEIGHT + gap) - gap, columns * (WIDTH + gap) - gap, 3)
    for index, expected in enumerate(itertools.islice(pictures(), count)):
        top, left = (HEIGHT + gap) * (index // columns), (WIDTH + gap) * (index % columns)
        np.testing.assert_array_equal(read[top : top + HEIGHT, left : left + WIDTH], expected)


@pytest.mark.parametrize("size", [(640, 480), (480, 360), (320, 240)])
def test_captions_fit_into_the_picture_and_leave_the_rest_of_it_alone(size: tuple[int, int]) -> None:
    width, height = size
    grey = np.full((height, width, 3), 128, np.uint8)
    caption = Caption(
        "123.4 s   step 2468   -0.12 m/s",
        "damage: missing toe (back right) + jammed joint (front right)",
        "controller: diagnosed as missing toe (back right) + jammed joint (front right), confidence 100 %,"
        " policy adapted",
        damaged=True,
    )
    calm = caption._replace(damaged=False)
    red, black = letter([grey, grey], [caption, calm], width, height)
    changed = np.argwhere((red != 128).any(axis=2))
    assert changed[:, 0].max() < height / 3
    assert changed[:, 1].max() < width - 1, "the longest line does not touch the edge"
    assert (red[-1] == 128).all()

    def is_red(picture: Picture) -> NDArray[np.bool_]:
        return (picture[..., 0] > 150) & (picture[..., 1] < 100) & (picture[..., 2] < 100)

    assert is_red(red).sum() > 20
    assert not is_red(black).any()
    # Dark letters on a light ground.
    assert red.min() < 90
    assert red.max() > 200


@pytest.fixture
def walk() -> Walk:
    table = dappo_batch.compile_class_table("ant", max_damaged_limbs=1)
    qpos = np.tile(table.models[0].qpos0, (5, 1))
    return Walk(table, qpos, "missing_toe@0", 2)


def canned(_: object) -> Iterator[Picture]:
    """Stand in for the painter."""
    return iter([np.full((480, 640, 3), 7, np.uint8)] * 5)


def test_a_film_that_fails_halfway_leaves_the_older_one_as_it_was(
    walk: Walk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def breaking(_: object) -> Iterator[Picture]:
        yield from itertools.islice(canned(_), 2)
        raise RenderError("failed")

    path = tmp_path / "film.mp4"
    monkeypatch.setattr(film, "draw", canned)
    assert render.write(path, walk) == 5
    before = path.read_bytes()
    monkeypatch.setattr(film, "draw", breaking)
    with pytest.raises(RenderError, match="failed"):
        render.write(path, walk)
    assert path.read_bytes() == before
    assert [file.name for file in tmp_path.iterdir()] == ["film.mp4"]


def test_progress_is_reported_after_every_frame(
    walk: Walk, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(film, "draw", canned)
    calls: list[tuple[int, int]] = []
    render.write(tmp_path / "film.gif", walk, progress=lambda drawn, count: calls.append((drawn, count)))
    assert calls == [(1, 5), (2, 5), (3, 5), (4, 5), (5, 5)]


@pytest.mark.parametrize("strip", [0, 65])
def test_a_strip_of_no_or_too_many_frames_is_rejected(strip: int, walk: Walk, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="strip must be"):
        render.write(tmp_path / "film.png", walk, strip=strip)


def test_a_file_of_another_kind_or_in_no_folder_or_of_odd_size_is_rejected(
    walk: Walk, tmp_path: Path
) -> None:
    with pytest.raises(ConfigError, match=r"'\.avi', expected one of \.mp4, \.gif, \.png"):
        render.check(tmp_path / "film.avi")
    with pytest.raises(ConfigError, match="there is no folder"):
        render.check(tmp_path / "nowhere" / "film.mp4")
    with pytest.raises(ConfigError, match="size is 641 by 480, expected at least 1 by 1 and even"):
        render.write(tmp_path / "film.mp4", walk, size=(641, 480))


@pytest.mark.parametrize(
    ("absent", "message"),
    [(("av",), "av is not installed"), (("av", "PIL"), "pillow and av are not installed")],
)
def test_packages_that_are_missing_are_named_with_the_command_that_installs_them(
    absent: tuple[str, ...], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    find: Callable[..., object] = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name, *more: None if name in absent else find(name, *more)
    )
    with pytest.raises(MissingExtraError, match=rf"{message}.*pip install 'dappo-batch\[video\]'") as caught:
        render.check(tmp_path / "film.mp4")
    assert isinstance(caught.value, DappoError)


def test_where_no_opengl_works_each_one_that_was_tried_is_named_with_its_reason_and_its_cure(
    walk: Walk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(opengl, "choices", lambda: ["egl", "osmesa"])
    # The painter looks for its libraries and finds none of the right kind.
    monkeypatch.setattr(opengl, "INSTALL", {"egl": "apt-get install one", "osmesa": "apt-get install other"})
    monkeypatch.setattr(opengl, "PAINTER", ("-c", "import sys; sys.exit('no library at all')"))
    with pytest.raises(RenderError) as caught:
        list(render.frames(walk, [0]))
    message = str(caught.value)
    assert "egl: no library at all; osmesa: no library at all" in message
    assert "`apt-get install one` or `apt-get install other`" in message
    assert "dappo-batch doctor" in message


def test_an_opengl_that_fails_in_between_is_an_error_and_no_shorter_film(
    walk: Walk, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = "sys.stdin.buffer.read(); sys.stdout.buffer.write(bytes(640 * 480 * 3))"
    monkeypatch.setattr(opengl, "choices", lambda: ["egl"])
    monkeypatch.setattr(opengl, "PAINTER", ("-c", f"import sys; {picture}; sys.exit('crash')"))
    with pytest.raises(RenderError, match="egl failed after 1 pictures: crash"):
        list(render.frames(walk, [0, 1]))


def test_a_window_without_a_screen_is_rejected_with_what_works_instead(
    walk: Walk, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(RenderError, match=r"no screen.*`dappo-batch view --browser`"):
        render.view(walk)
    monkeypatch.setenv("DISPLAY", ":0")
    render.check_screen()


def test_a_window_shows_the_body_of_the_damaged_robot_as_well_as_its_colours(walk: Walk) -> None:
    scenery, parse = with_scenery(walk.table), walk.table.space.parse
    healthy, damaged = (painted(walk.table, parse(name), scenery) for name in (0, walk.damage))
    copy_class(healthy, damaged)
    toe = healthy.geom(walk.table.robot.limbs[0].toe_geom)
    np.testing.assert_array_equal(
        toe.size, walk.table.models[walk.table.space.parse("missing_toe@0")].geom(toe.id).size
    )
    np.testing.assert_array_equal(toe.rgba, np.float32(RED))


@pytest.mark.parametrize(
    ("variables", "expected"),
    [
        ({}, ["egl", "osmesa"]),
        ({"DISPLAY": ":0"}, ["glfw", "egl", "osmesa"]),
        ({"WAYLAND_DISPLAY": "wayland-0"}, ["glfw", "egl", "osmesa"]),
        ({"MUJOCO_GL": "osmesa"}, ["osmesa"]),
        ({"MUJOCO_GL": "egl", "DISPLAY": ":0"}, ["egl"]),
    ],
)
def test_the_opengl_is_the_users_or_else_the_first_that_works_with_or_without_a_screen(
    variables: dict[str, str], expected: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.platform", "linux")
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "MUJOCO_GL"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)
    assert opengl.choices() == expected


def test_several_processes_draw_the_same_frames_as_one(walk: Walk, monkeypatch: pytest.MonkeyPatch) -> None:
    # The robot moves 3 m, and the lights with it, as far as the camera has moved since the first frame.
    qpos = np.tile(walk.states[0], (5, 1))
    qpos[:, 0] = np.linspace(0.0, 3.0, 5)
    moving = Walk(walk.table, qpos, "missing_toe@0", 2)
    started: list[int] = []
    start = opengl.start
    monkeypatch.setattr(opengl, "start", lambda *given: started.append(1) or start(*given))
    drawn = {}
    for cores in (1, 2):
        monkeypatch.setattr(opengl, "_PICTURES_EACH", 1)
        monkeypatch.setattr(opengl, "_cores", lambda cores=cores: cores)
        drawn[cores] = np.array(list(render.frames(moving, [0, 1, 2, 3, 4], size=(96, 64))))
    assert len(started) == 1 + 2
    np.testing.assert_array_equal(drawn[2], drawn[1])


def test_the_process_that_fails_among_several_is_the_one_whose_reason_is_given(
    walk: Walk, monkeypatch: pytest.MonkeyPatch
) -> None:
    picture = "sys.stdin.buffer.read(); sys.stdout.buffer.write(bytes(640 * 480 * 3))"
    monkeypatch.setattr(opengl, "choices", lambda: ["egl"])
    monkeypatch.setattr(opengl, "PAINTER", ("-c", f"import sys; {picture}; sys.exit('crash')"))
    monkeypatch.setattr(opengl, "_PICTURES_EACH", 1)
    monkeypatch.setattr(opengl, "_cores", lambda: 2)
    with pytest.raises(RenderError, match="egl failed after 2 pictures: crash"):
        list(render.frames(walk, [0, 1, 2]))


class Window:
    """Stand in for MuJoCo's window: it keeps where the first light is, and closes after the fifth state."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, **_: bool) -> None:
        self.model, self.data, self.cam = model, data, mujoco.MjvCamera()
        self.lights: list[NDArray[np.float64]] = []

    def __enter__(self) -> Window:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def is_running(self) -> bool:
        return len(self.lights) < 5

    def lock(self) -> contextlib.AbstractContextManager[None]:
        return contextlib.nullcontext()

    def set_texts(self, texts: object) -> None:
        assert texts

    def sync(self) -> None:
        self.lights.append(self.data.light_xpos[0].copy())


def test_a_window_has_the_shadows_of_a_film_and_its_lights_follow_the_robot(
    walk: Walk, monkeypatch: pytest.MonkeyPatch
) -> None:
    qpos = np.tile(walk.states[0], (5, 1))
    qpos[:, 0] = np.linspace(0.0, 3.0, 5)
    moving = Walk(walk.table, qpos, "missing_toe@0", 2)
    opened: list[Window] = []

    def launch(*given: Any, **more: Any) -> Window:  # noqa: ANN401
        opened.append(Window(*given, **more))
        return opened[0]

    viewer = ModuleType("mujoco.viewer")
    monkeypatch.setattr(viewer, "launch_passive", launch, raising=False)
    monkeypatch.setitem(sys.modules, "mujoco.viewer", viewer)
    monkeypatch.setattr(mujoco, "viewer", viewer, raising=False)
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(window, "_PAUSE_SECONDS", 0.0)
    render.view(moving)
    drawn = scene(moving, [0, 4], 640, 480)
    (shown,) = opened
    assert shown.model.vis.map.shadowclip == drawn.models[0].vis.map.shadowclip
    travelled = drawn.view.lookat[1] - drawn.view.lookat[0]
    assert travelled[0] > 1.0
    np.testing.assert_allclose(shown.lights[4] - shown.lights[0], travelled, atol=1e-9)
