"""The process that draws: reads a `Scene`, or `Live` and one `Pose` after the other; writes raw pictures.

A process of its own: MuJoCo chooses its OpenGL when it is imported, and a bad driver may crash.
"""

from __future__ import annotations

import os
import pickle
import sys
from collections.abc import Iterator

import mujoco
import numpy as np
from numpy.typing import NDArray

from dappo_batch.render.live import Live, Pose
from dappo_batch.render.scene import Scene, become

__all__ = ["main", "paint"]


def paint(scene: Scene) -> Iterator[NDArray[np.uint8]]:
    """Draw the pictures of a scene, each uint8[height, width, 3]."""
    renderers = {
        damage_class: mujoco.Renderer(model, scene.height, scene.width)
        for damage_class, model in scene.models.items()
    }
    data = {damage_class: mujoco.MjData(model) for damage_class, model in scene.models.items()}
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation = scene.view.azimuth, scene.view.elevation
    camera.distance = scene.view.distance
    for damage_class, qpos, lookat in zip(scene.damage_classes, scene.qpos, scene.view.lookat, strict=True):
        state, renderer = data[damage_class], renderers[damage_class]
        state.qpos[:] = qpos
        mujoco.mj_forward(scene.models[damage_class], state)
        camera.lookat[:] = lookat
        renderer.update_scene(state, camera)
        _bring_shadows(renderer.scene, lookat, scene.view.distance)
        yield renderer.render()


def paint_live(live: Live, poses: Iterator[Pose]) -> Iterator[NDArray[np.uint8]]:
    """Draw a robot pose by pose, each uint8[height, width, 3]."""
    model = live.model
    buffer = model.vis.global_
    buffer.offwidth, buffer.offheight = max(buffer.offwidth, live.width), max(buffer.offheight, live.height)
    renderer, data = mujoco.Renderer(model, live.height, live.width), mujoco.MjData(model)
    for pose in poses:
        if pose.model is not None:
            become(model, pose.model)
        data.qpos[:] = pose.qpos
        mujoco.mj_forward(model, data)
        renderer.update_scene(data, live.camera)
        yield renderer.render()


def _poses() -> Iterator[Pose]:
    while True:
        try:
            yield pickle.load(sys.stdin.buffer)
        except EOFError:
            return


def _bring_shadows(drawn: mujoco.MjvScene, lookat: NDArray[np.float64], distance: float) -> None:
    """Let distant lights follow the robot: MuJoCo draws their shadows only in front of where they stand."""
    for light in drawn.lights[: drawn.nlight]:
        if light.castshadow and light.type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL:
            light.pos[:] = lookat - distance * light.dir


def main() -> None:
    """Draw what comes in."""
    told = pickle.load(sys.stdin.buffer)
    # Whatever a driver prints must not end up in the pictures.
    pictures = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    is_live = isinstance(told, Live)
    for index, picture in enumerate(paint_live(told, _poses()) if is_live else paint(told)):
        if index == 0 and not picture.any():
            sys.exit("the picture is black")
        pictures.write(picture.tobytes())
        if is_live:
            pictures.flush()
    pictures.flush()
    # Freeing some software renderers fails, which says nothing about the pictures.
    os._exit(0)


if __name__ == "__main__":
    main()
