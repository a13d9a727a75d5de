"""A web page that shows an episode, for machines without a screen; needs the extra ``viewer``."""

from __future__ import annotations

import copy
import errno
import socket
import sys
import time
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from dappo_batch._checks import integer, text
from dappo_batch._extras import require
from dappo_batch.render.camera import AUTO, View, check_camera
from dappo_batch.render.camera import view as camera_of
from dappo_batch.render.captions import Caption, captions
from dappo_batch.render.errors import RenderError
from dappo_batch.render.scene import coloured_models, copy_class
from dappo_batch.render.walk import Walk, of_walk

if TYPE_CHECKING:
    from viser import ViserServer

__all__ = ["Player", "browse", "check_browser"]

_SPEEDS = ("1", "1/2", "1/4", "1/10")


def check_browser(host: str = "localhost", port: int = 8080) -> None:
    """Check the packages and the address of a page.

    Raises
    ------
    MissingExtraError
        If packages are missing.
    RenderError
        If the address cannot be used.
    ConfigError
        If host or port is invalid.
    """
    text(host, "host")
    integer(port, "port", 0, 65535)
    require("viewer", "pages with walks")
    try:
        socket.create_server((host, port)).close()
    except (OSError, TypeError, ValueError) as error:
        # The server tries the next ports, but blocks on an address of another machine.
        if not isinstance(error, OSError) or error.errno != errno.EADDRINUSE:
            raise RenderError(f"no page can be served at {host}:{port}: {error}") from error


def browse(walk: Walk, host: str = "localhost", port: int = 8080, camera: str = AUTO) -> None:
    """Serve a page that shows an episode in real time, in a loop, until Ctrl-C.

    Parameters
    ----------
    walk : Walk
        The episode.
    host : str
        Address of the page: ``localhost`` for this machine only, ``0.0.0.0`` for all interfaces.
    port : int
        The port, or the first free one after it.
    camera : str
        From where visitors look at first: ``"auto"`` or a side of the robot, as in `write`. A camera of the
        MJCF gives its direction alone.

    Raises
    ------
    ConfigError
        If there is no such camera.
    MissingExtraError, RenderError
        If packages are missing or the page cannot be served.
    """
    of_walk(walk)
    check_camera(walk.table, camera)
    check_browser(host, port)
    # Imported here, because only this needs the extra.
    from viser import ViserServer

    server = ViserServer(host=host, port=port, label="dappo-batch")
    try:
        player = Player(walk, server, camera)
        address = f"http://{host}:{server.get_port()}"
        print(f"{address} shows the episode until Ctrl-C", file=sys.stderr, flush=True)
        player.play()
    finally:
        server.stop()


class Player:
    """A walk on a page: the robot, its caption, and the controls of a visitor.

    Parameters
    ----------
    walk : Walk
        The episode.
    server : viser.ViserServer
        Server of the page.
    camera : str
        From where visitors look at first.
    """

    def __init__(self, walk: Walk, server: ViserServer, camera: str = AUTO) -> None:
        from mjviser import ViserMujocoScene

        self._walk = walk
        self._classes = walk.damage_classes.tolist()
        self._captions = captions(walk)
        self._models = coloured_models(walk.table, self._classes)
        self._camera = camera_of(
            walk.table,
            walk.states,
            walk.step_seconds,
            camera=camera,
            damage_class=self._classes[-1],
        )
        self._shown = self._classes[0]
        self._scene = ViserMujocoScene(server, copy.copy(self._models[self._shown]), num_envs=1)
        # The tracking of the viewer would move the floor with every sway of the robot.
        self._scene.camera_tracking_enabled = False
        self._look(server, self._camera)
        self.caption = server.gui.add_markdown("")
        self.step = server.gui.add_slider(
            "step", min=0, max=max(1, len(self._classes) - 1), step=1, initial_value=0
        )
        self.playing = server.gui.add_checkbox("play", initial_value=True)
        self.speed = server.gui.add_dropdown("speed", _SPEEDS)
        self.show(0)

    @staticmethod
    def _look(server: ViserServer, camera: View) -> None:
        """Set the initial camera to that of films."""
        azimuth, elevation = np.radians([camera.azimuth, camera.elevation])
        ahead = np.array(
            [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
        )
        server.initial_camera.position = tuple(-camera.distance * ahead)
        server.initial_camera.look_at = (0.0, 0.0, 0.0)
        server.initial_camera.fov = float(np.radians(camera.fovy))
        server.scene.set_up_direction("+z")

    def show(self, step: int) -> None:
        """Show a state of the episode.

        Parameters
        ----------
        step : int
            Its index.
        """
        damage_class = self._classes[step]
        scene = self._scene
        if damage_class != self._shown:
            copy_class(scene.mj_model, self._models[damage_class])
            scene.rebuild_visual_handles()
            self._shown = damage_class
        data = scene.mj_data
        data.qpos[:] = self._walk.states[step]
        mujoco.mj_kinematics(scene.mj_model, data)
        # The world moves instead of the camera.
        middle = self._camera.lookat[step]
        scene.update_from_arrays(data.xpos[None] - middle, data.xmat.reshape(1, -1, 3, 3))
        scene.fixed_bodies_frame.position = tuple(-middle)
        self.caption.content = _marked_down(self._captions[step])

    def play(self) -> None:
        """Show all states in a loop, until interrupted."""
        shown = 0
        while True:
            begin = time.perf_counter()
            step = min(int(self.step.value), len(self._classes) - 1)
            if step != shown:
                self.show(step)
                shown = step
            slowness = int(self.speed.value.rpartition("/")[2])
            time.sleep(max(0.0, slowness * self._walk.step_seconds - (time.perf_counter() - begin)))
            # The slider may have been moved.
            if self.playing.value and self.step.value == step:
                self.step.value = (step + 1) % len(self._classes)  # type: ignore[misc]


def _marked_down(caption: Caption) -> str:
    damage = f"**{caption.damage}**" if caption.damaged else caption.damage
    return "\n\n".join(line for line in (caption.time, damage, caption.finding) if line)
