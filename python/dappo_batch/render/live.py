"""Pictures of running environments, drawn one at a time by a persistent process."""

from __future__ import annotations

import os
import pickle
import subprocess
import tempfile
import weakref
from dataclasses import dataclass
from typing import IO

import mujoco
import numpy as np
from numpy.typing import NDArray

from dappo_batch.model import ClassTable
from dappo_batch.render import opengl
from dappo_batch.render.camera import View, view
from dappo_batch.render.scene import fit, painted
from dappo_batch.render.scenery import with_scenery

__all__ = ["Live", "LivePainter", "Pose"]


@dataclass(frozen=True, eq=False)
class Live:
    """The first message to the drawing process: model of the robot, camera, and size of frames."""

    model: mujoco.MjModel
    view: View
    main_body: int
    height: int
    width: int


@dataclass(frozen=True, eq=False)
class Pose:
    """The message for a frame: positions [nq], and the model if it has changed."""

    model: mujoco.MjModel | None
    qpos: NDArray[np.float64]


class LivePainter:
    """Draws robots of one class table with the first OpenGL implementation that works.

    Parameters
    ----------
    table : ClassTable
        The robot and its damage classes.
    height, width : int
        Size of a frame.
    """

    def __init__(self, table: ClassTable, height: int, width: int) -> None:
        self._table = table
        self._scenery = with_scenery(table)
        self._view = view(table, table.models[0].qpos0[None], 1.0, aspect=width / height)
        self._live = Live(self._look(0), self._view, table.main_body, height, width)
        self._painter: subprocess.Popen[bytes] | None = None
        self._complaints: IO[bytes] | None = None
        self._choice, self._shown = "", 0
        self._process = os.getpid()
        self._end: weakref.finalize[..., LivePainter] | None = None

    def draw(self, damage_class: int, qpos: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Draw a robot of a damage class, uint8[height, width, 3].

        Raises
        ------
        RenderError
            If no OpenGL implementation works, or it fails later.
        """
        if self._process != os.getpid():
            self._forget()
        if self._painter is not None:
            picture = self._ask(damage_class, qpos)
            if picture is None:
                raise opengl.failed(self._choice, f"while drawing: {self._why()}")
            return picture
        reasons = {}
        for choice in opengl.choices():
            self._start(choice)
            picture = self._ask(damage_class, qpos)
            if picture is not None:
                return picture
            reasons[choice or "OpenGL"] = self._why()
        raise opengl.none_works(reasons)

    def _look(self, damage_class: int) -> mujoco.MjModel:
        model = painted(self._table, damage_class, self._scenery)
        fit(model, self._view)
        return model

    def close(self) -> None:
        """End the process."""
        if self._end is not None:
            self._end()
        self._painter = None

    def _forget(self) -> None:
        """Leave the drawing process to the parent after a fork."""
        self.close()
        self._process = os.getpid()

    def _start(self, choice: str) -> None:
        complaints = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the process runs
        painter = opengl.start(choice, complaints)
        self._painter, self._complaints, self._choice, self._shown = painter, complaints, choice, 0
        self._end = weakref.finalize(self, _stop, painter, complaints, os.getpid())
        _send(painter, self._live)

    def _ask(self, damage_class: int, qpos: NDArray[np.float64]) -> NDArray[np.uint8] | None:
        """Return a picture, None if the process has ended."""
        assert self._painter is not None
        assert self._painter.stdout is not None
        model = None if damage_class == self._shown else self._look(damage_class)
        height, width = self._live.height, self._live.width
        try:
            if not _send(self._painter, Pose(model, np.array(qpos))):
                return None
            self._shown = damage_class
            content = self._painter.stdout.read(height * width * 3)
        except BaseException:
            # An interruption may leave half of a message in a pipe, so the next picture uses a new process.
            self.close()
            raise
        if len(content) < height * width * 3:
            return None
        return np.frombuffer(content, np.uint8).reshape(height, width, 3).copy()

    def _why(self) -> str:
        """Return why the process has ended, and release it."""
        assert self._painter is not None
        assert self._complaints is not None
        self._painter.wait()
        reason = opengl.last_line(self._complaints) or f"exit code {self._painter.returncode}"
        self.close()
        return reason


def _send(painter: subprocess.Popen[bytes], message: Live | Pose) -> bool:
    assert painter.stdin is not None
    try:
        pickle.dump(message, painter.stdin)
        painter.stdin.flush()
    except BrokenPipeError:
        return False
    return True


def _stop(painter: subprocess.Popen[bytes], complaints: IO[bytes], process: int) -> None:
    # A forked process closes its copies of the pipes and does not end the drawing process.
    if os.getpid() == process:
        painter.kill()
        painter.wait()
    for pipe in (painter.stdin, painter.stdout):
        if pipe is not None:
            try:
                pipe.close()
            except BrokenPipeError:
                continue
    complaints.close()
