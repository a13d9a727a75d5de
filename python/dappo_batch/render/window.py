"""A window that shows an episode in a loop, with a movable camera."""

from __future__ import annotations

import copy
import os
import sys
import time

import mujoco

from dappo_batch.render.camera import AUTO, check_camera
from dappo_batch.render.camera import view as camera_of
from dappo_batch.render.captions import Caption, captions
from dappo_batch.render.errors import RenderError
from dappo_batch.render.scene import bring_lights, coloured_models, copy_class, fit
from dappo_batch.render.walk import Walk, of_walk

__all__ = ["check_screen", "view"]

_PAUSE_SECONDS = 1.0  # between two repetitions


def check_screen() -> None:
    """Check that there is a screen.

    Raises
    ------
    RenderError
        If there is no screen.
    """
    names = ("DISPLAY", "WAYLAND_DISPLAY")
    if sys.platform == "linux" and not any(os.environ.get(name) for name in names):
        raise RenderError(
            "there is no screen to open a window on (neither DISPLAY nor WAYLAND_DISPLAY is set);"
            " `dappo-batch view --browser` shows the walk on a page,"
            " and `dappo-batch render` draws it into a file"
        )


def view(walk: Walk, camera: str = AUTO) -> None:
    """Show an episode in a window in real time, in a loop, until the window is closed.

    Parameters
    ----------
    walk : Walk
        The episode.
    camera : str
        Where the camera starts: ``"auto"``, a side of the robot, or a camera of the MJCF, as in `write`.

    Raises
    ------
    ConfigError
        If there is no such camera.
    RenderError
        If there is no screen.
    """
    of_walk(walk)
    check_camera(walk.table, camera)
    check_screen()
    # Imported here, because the import needs a screen.
    from mujoco import viewer

    classes, said = walk.damage_classes.tolist(), captions(walk)
    models = coloured_models(walk.table, classes)
    start = camera_of(walk.table, walk.states, walk.step_seconds, camera=camera, damage_class=classes[-1])
    for each in models.values():
        fit(each, start)
    shown, model = classes[0], copy.copy(models[classes[0]])
    data = mujoco.MjData(model)
    data.qpos[:] = walk.states[0]
    with viewer.launch_passive(model, data, show_left_ui=False, show_right_ui=False) as window:
        window.cam.type = mujoco.mjtCamera.mjCAMERA_TRACKING
        window.cam.trackbodyid = walk.table.main_body
        if start.fixed >= 0:
            window.cam.type, window.cam.fixedcamid = mujoco.mjtCamera.mjCAMERA_FIXED, start.fixed
        window.cam.azimuth, window.cam.elevation = start.azimuth, start.elevation
        window.cam.distance = start.distance
        while window.is_running():
            for state, lookat, damage_class, caption in zip(
                walk.states, start.lookat, classes, said, strict=True
            ):
                if not window.is_running():
                    return
                begin = time.perf_counter()
                with window.lock():
                    if damage_class != shown:
                        copy_class(model, models[damage_class])
                        shown = damage_class
                    data.qpos[:] = state
                    mujoco.mj_forward(model, data)
                    bring_lights(model, data, start, lookat, start.lookat[0])
                window.set_texts((None, None, _plain(caption), None))
                window.sync()
                time.sleep(max(0.0, walk.step_seconds - (time.perf_counter() - begin)))
            time.sleep(_PAUSE_SECONDS)


def _plain(caption: Caption) -> str:
    """Return the caption in the characters that MuJoCo's windows support."""
    lines = [line for line in (caption.time, caption.damage, caption.finding) if line]
    return "\n".join(lines).replace("…", "...")
