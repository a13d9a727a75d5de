"""The drawing process: reads a `Scene`, or `Live` and one `Pose` after the other; writes raw frames.

A separate process: MuJoCo chooses its OpenGL at import, and a faulty driver may crash.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from dappo_batch.render.camera import View
from dappo_batch.render.live import Live, Pose
from dappo_batch.render.scene import Scene, bring_lights, copy_class

__all__ = ["main", "paint", "reduced"]

_LARGEST_SMOOTH = 4096  # pixels; OpenGL draws at most 16384
_SAMPLES = 4  # of a pixel in other frames


def paint(scene: Scene) -> Iterator[NDArray[np.uint8]]:
    """Draw the frames of a scene, each uint8[height, width, 3]."""
    canvases = {
        damage_class: _Canvas(model, scene.view, scene.height, scene.width)
        for damage_class, model in scene.models.items()
    }
    for damage_class, qpos, lookat in zip(scene.damage_classes, scene.qpos, scene.view.lookat, strict=True):
        canvas = canvases[damage_class]
        canvas.pose(qpos)
        yield canvas.draw(lookat, scene.start)


def paint_live(live: Live, poses: Iterator[Pose]) -> Iterator[NDArray[np.uint8]]:
    """Draw a robot pose by pose, each uint8[height, width, 3]."""
    canvas = _Canvas(live.model, live.view, live.height, live.width)
    start = live.view.lookat[0]
    for pose in poses:
        if pose.model is not None:
            copy_class(live.model, pose.model)
        canvas.pose(pose.qpos)
        main = canvas.data.xpos[live.main_body]
        yield canvas.draw(np.array([main[0], main[1], start[2]]), start)


class _Canvas:
    """A model and its renderer."""

    def __init__(self, model: mujoco.MjModel, view: View, height: int, width: int) -> None:
        self.data = mujoco.MjData(model)
        self._model, self._view = model, view
        # Averages of larger frames have smooth shadows too, unlike multisampling, and take less time.
        self._is_larger = height % 2 == width % 2 == 0 and max(height, width) <= _LARGEST_SMOOTH
        buffer = model.vis.global_
        buffer.offheight, buffer.offwidth = height, width
        if self._is_larger:
            buffer.offheight, buffer.offwidth = height * 3 // 2, width * 3 // 2
        model.vis.quality.offsamples = 0 if self._is_larger else _SAMPLES
        self._renderer = mujoco.Renderer(model, buffer.offheight, buffer.offwidth)
        self._camera = mujoco.MjvCamera()
        if view.fixed >= 0:
            self._camera.type = mujoco.mjtCamera.mjCAMERA_FIXED
            self._camera.fixedcamid = view.fixed
        self._camera.azimuth, self._camera.elevation = view.azimuth, view.elevation
        self._camera.distance = view.distance

    def pose(self, qpos: NDArray[np.float64]) -> None:
        """Set the positions [nq]."""
        self.data.qpos[:] = qpos
        mujoco.mj_forward(self._model, self.data)

    def draw(self, lookat: NDArray[np.float64], start: NDArray[np.float64]) -> NDArray[np.uint8]:
        """Draw what the camera sees when it looks at a place, having begun at another."""
        self._camera.lookat[:] = lookat
        bring_lights(self._model, self.data, self._view, lookat, start)
        self._renderer.update_scene(self.data, self._camera)
        frame: NDArray[np.uint8] = self._renderer.render()
        return reduced(frame) if self._is_larger else frame


def reduced(frame: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return two thirds of the height and width of a frame, each pixel the mean of the area below it."""
    height, width = frame.shape[0] * 2 // 3, frame.shape[1] * 2 // 3
    rows = np.empty((height, frame.shape[1], 3), np.uint16)
    rows[0::2] = 2 * frame[0::3].astype(np.uint16) + frame[1::3]
    rows[1::2] = 2 * frame[2::3].astype(np.uint16) + frame[1::3]
    reduced = np.empty((height, width, 3), np.uint8)
    reduced[:, 0::2] = (2 * rows[:, 0::3] + rows[:, 1::3] + 4) // 9
    reduced[:, 1::2] = (2 * rows[:, 2::3] + rows[:, 1::3] + 4) // 9
    return reduced


def _poses() -> Iterator[Pose]:
    while True:
        try:
            yield pickle.load(sys.stdin.buffer)
        except EOFError:
            return


def main() -> None:
    """Read messages and write frames."""
    order = pickle.load(sys.stdin.buffer)
    # Output of drivers must not be mixed with pictures.
    pictures = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    is_live = isinstance(order, Live)
    for index, picture in enumerate(paint_live(order, _poses()) if is_live else paint(order)):
        if index == 0 and not picture.any():
            sys.exit("the picture is black")
        pictures.write(picture.tobytes())
        if is_live:
            pictures.flush()
    pictures.flush()
    # Freeing some software renderers fails, which does not affect the pictures.
    os._exit(0)


if __name__ == "__main__":
    main()
