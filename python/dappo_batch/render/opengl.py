"""Selection of an OpenGL implementation that works, with or without a screen, and drawing with it."""

from __future__ import annotations

import contextlib
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
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
_MOST_PAINTERS = 4
_PICTURES_EACH = 20  # a process takes as long to start as it takes for several pictures


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
    count = max(1, min(_cores(), _MOST_PAINTERS, len(scene.qpos) // _PICTURES_EACH))
    reasons = {}
    for choice in choices():
        with contextlib.ExitStack() as stack:
            painters = [_Painter(choice, stack) for _ in range(count)]
            try:
                yield from _pictures(painters, scene)
                return
            except _Silent as silent:
                reason = silent.painter.reason()
                if silent.drawn > 0:
                    raise failed(choice, f"after {silent.drawn} pictures: {reason}") from None
                reasons[choice or "OpenGL"] = reason
    raise none_works(reasons)


def _cores() -> int:
    """Return the number of cores that this process may use."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class _Painter:
    """A drawing process, which ends with the stack, and what it wrote to its standard error."""

    def __init__(self, choice: str, stack: contextlib.ExitStack) -> None:
        self._complaints: IO[bytes] = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the process
        stack.callback(self._complaints.close)
        self._process = stack.enter_context(start(choice, self._complaints))
        stack.callback(self._process.kill)

    def send(self, scene: Scene) -> bool:
        """Send what to draw; false if the process has ended."""
        assert self._process.stdin is not None
        try:
            with self._process.stdin as pipe:
                pickle.dump(scene, pipe)
        except BrokenPipeError:
            return False
        return True

    def read(self, size: int) -> bytes:
        """Read a picture of this many bytes; fewer if the process has ended."""
        assert self._process.stdout is not None
        return self._process.stdout.read(size)

    def reason(self) -> str:
        """Wait for the end of the process, and return why it ended."""
        self._process.wait()
        return last_line(self._complaints) or f"exit code {self._process.returncode}"


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

    def __init__(self, painter: _Painter, drawn: int) -> None:
        self.painter, self.drawn = painter, drawn


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


def _pictures(painters: Sequence[_Painter], scene: Scene) -> Iterator[NDArray[np.uint8]]:
    """Draw a scene with several processes, which take turns."""
    for first, painter in enumerate(painters):
        if not painter.send(scene.every(len(painters), first)):
            raise _Silent(painter, 0)
    size = scene.height * scene.width * 3
    for drawn in range(len(scene.qpos)):
        painter = painters[drawn % len(painters)]
        content = painter.read(size)
        if len(content) < size:
            raise _Silent(painter, drawn)
        yield np.frombuffer(content, np.uint8).reshape(scene.height, scene.width, 3)


def last_line(complaints: IO[bytes]) -> str:
    """Return the last line of the output of a process."""
    complaints.seek(0)
    lines = complaints.read().decode(errors="replace").strip().splitlines()
    return lines[-1].strip() if lines else ""
