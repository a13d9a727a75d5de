"""Selection of an OpenGL implementation that works, with or without a screen, and drawing with it."""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping
from typing import IO

import numpy as np
from numpy.typing import NDArray

from dappo_batch.render.errors import RenderError
from dappo_batch.render.scene import Scene

__all__ = ["INSTALL", "PAINTER", "choices", "draw", "failed", "last_line", "none_works", "start"]

INSTALL = {
    "egl": "apt-get install libegl1 libgl1-mesa-dri",
    "osmesa": "apt-get install libosmesa6",
}
"""Commands that install OpenGL implementations without a screen."""
PAINTER = ("-m", "dappo_batch.render.painter")
"""Module of the drawing process."""


def choices() -> list[str]:
    """Return the values of ``MUJOCO_GL`` to try, the best first; an empty one is MuJoCo's own choice."""
    wanted = os.environ.get("MUJOCO_GL", "")
    if wanted or sys.platform != "linux":
        return [wanted]
    has_screen = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    return ["glfw", *INSTALL] if has_screen else [*INSTALL]


def draw(scene: Scene) -> Iterator[NDArray[np.uint8]]:
    """Draw the pictures of a scene, each uint8[height, width, 3].

    Raises
    ------
    RenderError
        If no OpenGL implementation works, or it fails while drawing.
    """
    reasons = {}
    for choice in choices():
        with tempfile.TemporaryFile() as complaints, start(choice, complaints) as painter:
            try:
                yield from _pictures(painter, scene)
                return
            except _Silent as silent:
                painter.wait()
                reason = last_line(complaints) or f"exit code {painter.returncode}"
                if silent.drawn > 0:
                    raise failed(choice, f"after {silent.drawn} pictures: {reason}") from None
                reasons[choice or "OpenGL"] = reason
            finally:
                painter.kill()
    raise none_works(reasons)


def none_works(reasons: Mapping[str, str]) -> RenderError:
    """Return the error with the reasons why no OpenGL implementation works, and what to install."""
    tried = "; ".join(f"{choice}: {reason}" for choice, reason in reasons.items())
    cure = " or ".join(f"`{INSTALL[choice]}`" for choice in reasons if choice in INSTALL)
    return RenderError(
        f"pictures need OpenGL, and no implementation works ({tried}){f'; try {cure}' if cure else ''};"
        " see `dappo-batch doctor`"
    )


def failed(choice: str, reason: str) -> RenderError:
    """Return the error of an OpenGL implementation that failed after it had worked."""
    return RenderError(f"{choice or 'OpenGL'} failed {reason}")


class _Silent(Exception):
    """The drawing process ended before all pictures were drawn."""

    def __init__(self, drawn: int) -> None:
        self.drawn = drawn


def start(choice: str, complaints: IO[bytes]) -> subprocess.Popen[bytes]:
    """Start a drawing process."""
    environment = dict(os.environ)
    if choice:
        environment["MUJOCO_GL"] = choice
    if choice in INSTALL:
        environment["PYOPENGL_PLATFORM"] = choice
    return subprocess.Popen(
        [sys.executable, *PAINTER],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=complaints,
        env=environment,
    )


def _pictures(painter: subprocess.Popen[bytes], scene: Scene) -> Iterator[NDArray[np.uint8]]:
    assert painter.stdin is not None
    assert painter.stdout is not None
    try:
        with painter.stdin as pipe:
            pickle.dump(scene, pipe)
    except BrokenPipeError:
        raise _Silent(0) from None
    size = scene.height * scene.width * 3
    for drawn in range(len(scene.qpos)):
        content = painter.stdout.read(size)
        if len(content) < size:
            raise _Silent(drawn)
        yield np.frombuffer(content, np.uint8).reshape(scene.height, scene.width, 3)


def last_line(complaints: IO[bytes]) -> str:
    """Return the last line of the output of a process."""
    complaints.seek(0)
    lines = complaints.read().decode(errors="replace").strip().splitlines()
    return lines[-1].strip() if lines else ""
