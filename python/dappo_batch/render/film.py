"""Films of an episode as files."""

from __future__ import annotations

import contextlib
import os
import secrets
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from dappo_batch import _extras
from dappo_batch._checks import boolean, folder, integer, sequence, shown
from dappo_batch._core import ConfigError
from dappo_batch.render.camera import AUTO
from dappo_batch.render.captions import captions
from dappo_batch.render.errors import RenderError
from dappo_batch.render.opengl import draw
from dappo_batch.render.scene import scene
from dappo_batch.render.schedule import Schedule, evenly, schedule
from dappo_batch.render.walk import Walk, of_walk

__all__ = ["INSTALL", "check", "frames", "lacking", "whole", "write"]

MOST_PIXELS = 16384
MOST_FRAMES = 64
STRIP = 4
"""Frames of a PNG."""
INSTALL = _extras.install("video")


@dataclass(frozen=True)
class _Format:
    """Properties of a file format."""

    size: tuple[int, int]
    """Default width and height of a frame."""
    fastest: float
    """Maximum number of frames per second."""
    unit: float | None = None
    """Unit of the duration of a frame, s."""


_FORMATS = {
    ".mp4": _Format((640, 480), 30.0),
    # Files are large, and browsers slow down GIFs with more than 50 frames per second.
    ".gif": _Format((480, 360), 20.0, 0.01),
    ".png": _Format((640, 480), 1.0),
}


def check(path: str | bytes | PathLike[str], strip: int = STRIP) -> Path:
    """Return the path for `write` after a check, which can be done before the episode.

    Raises
    ------
    ConfigError
        If its ending is none of ``.mp4``, ``.gif`` and ``.png``, its folder does not exist, or `strip` is not
        from 1 to 64.
    MissingExtraError
        If packages are missing.
    """
    file = folder(path, "path")
    if file.suffix.lower() not in _FORMATS:
        raise ConfigError(f"{file} ends in {file.suffix!r}, expected one of {', '.join(_FORMATS)}")
    if not file.parent.is_dir():
        raise ConfigError(f"{file}: there is no folder {file.parent}")
    integer(strip, "strip", 1, MOST_FRAMES)
    _extras.require("video", "pictures")
    return file


def lacking() -> list[str]:
    """Return the packages of the extra ``video`` that are not installed."""
    return _extras.lacking("video")


def write(
    path: str | bytes | PathLike[str],
    walk: Walk,
    *,
    size: tuple[int, int] | None = None,
    captioned: bool = True,
    camera: str = AUTO,
    strip: int = STRIP,
    progress: Callable[[int, int], object] | None = None,
) -> int:
    """Write an episode to a file, in real time, and return the number of frames.

    Parameters
    ----------
    path : path-like
        A file that ends in ``.mp4``, ``.gif`` or ``.png``. A PNG is a strip of frames.
    walk : Walk
        The episode.
    size : tuple of int, optional
        Width and height of a frame, even for an mp4; by default 640 by 480, and 480 by 360 for a GIF.
    captioned : bool
        Whether time, damage and the state of the controller are written into the frames.
    camera : str
        ``"auto"``: from the side on which the damaged limbs are. ``"left"``, ``"right"``, ``"front"`` or
        ``"back"``: from that side of a robot that faces +x. All of them follow the main body at a distance
        that shows the whole robot. The name of a camera of the MJCF: what that camera sees.
    strip : int
        Frames of a PNG, evenly spaced from the first state to the last; 1 is the last.
    progress : callable, optional
        Called with the number of frames that are drawn and that of all.

    Raises
    ------
    ConfigError
        If the path, the size, the camera or the number of frames cannot be used.
    MissingExtraError, RenderError
        If packages are missing, or rendering is not possible; the message contains what to install.
    """
    file = check(path, strip)
    kind = file.suffix.lower()
    form = _FORMATS[kind]
    of_walk(walk)
    width, height = form.size if size is None else size_of(size)
    if min(width, height) < 1 or (kind == ".mp4" and (width % 2 or height % 2)):
        even = " and even for an mp4" if kind == ".mp4" else ""
        raise ConfigError(f"size is {width} by {height}, expected at least 1 by 1{even}")
    if kind == ".png":
        plan = Schedule(evenly(len(walk.states), strip), 1.0 / form.fastest)
    else:
        plan = schedule(len(walk.states), walk.step_seconds, fastest=form.fastest, unit=form.unit)
    drawn = frames(walk, plan.states, size=(width, height), captioned=captioned, camera=camera)
    if progress is not None:
        drawn = _reported(drawn, len(plan.states), progress)
    # Imported here, because only drawing needs the extra.
    from dappo_batch.render import encoders

    encode: dict[str, Callable[[Path], None]] = {
        ".mp4": lambda target: encoders.write_mp4(target, drawn, plan.seconds),
        ".gif": lambda target: encoders.write_gif(target, drawn, plan.seconds),
        ".png": lambda target: encoders.write_png(target, drawn),
    }
    with whole(file) as part:
        encode[kind](part)
    return len(plan.states)


def _reported(
    drawn: Iterator[NDArray[np.uint8]], count: int, progress: Callable[[int, int], object]
) -> Iterator[NDArray[np.uint8]]:
    for index, frame in enumerate(drawn):
        yield frame
        progress(index + 1, count)


def frames(
    walk: Walk,
    states: list[int],
    *,
    size: tuple[int, int] = (640, 480),
    captioned: bool = True,
    camera: str = AUTO,
) -> Iterator[NDArray[np.uint8]]:
    """Draw some states of an episode, each uint8[height, width, 3].

    Parameters
    ----------
    walk : Walk
        The episode.
    states : list of int
        Indices of the states.
    size : tuple of int
        Width and height.
    captioned : bool
        Whether time, damage and the state of the controller are written into the frames.
    camera : str
        As in `write`.

    Raises
    ------
    ConfigError
        If a state or the camera does not exist, or the size cannot be used.
    RenderError
        If rendering is not possible.
    """
    of_walk(walk)
    last = len(walk.states) - 1
    states = [integer(state, "a state", 0, last) for state in sequence(states, "states")]
    if not states:
        raise ConfigError("there are no states to draw")
    size = size_of(size)
    captioned = boolean(captioned, "captioned")
    drawn = draw(scene(walk, states, *size, camera))
    if not captioned:
        return drawn
    from dappo_batch.render.lettering import letter

    said = captions(walk)
    return letter(drawn, [said[state] for state in states], *size)


def size_of(size: object) -> tuple[int, int]:
    """Return a width and a height."""
    found = sequence(size, "size")
    if len(found) != 2:
        raise ConfigError(f"size must be a width and a height, got {shown(size)}")
    width, height = (integer(side, "size", 1, MOST_PIXELS) for side in found)
    return width, height


@contextlib.contextmanager
def whole(file: Path) -> Iterator[Path]:
    """Yield a temporary file, which is renamed when it is complete.

    Raises
    ------
    RenderError
        If a file cannot be written.
    """
    # The name is random, so that no link can exist under it.
    part = file.with_name(f".{file.stem[:100]}.{secrets.token_hex(8)}{file.suffix}")
    try:
        os.close(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o666))
        yield part
        os.replace(part, file)
    except OSError as error:
        raise RenderError(f"{file} cannot be written: {error}") from error
    finally:
        part.unlink(missing_ok=True)
