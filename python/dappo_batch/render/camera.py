"""Where the camera stands: as the robot file says, and gently moving along with the robot."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dappo_batch.model import ClassTable

__all__ = ["View", "view"]

_SMOOTHING_SECONDS = (
    1.0  # over which the robot's way is averaged, so that its gait does not shake the picture
)


@dataclass(frozen=True, eq=False)
class View:
    """A camera that looks in one direction and moves along.

    Attributes
    ----------
    azimuth, elevation : float
        Direction in which it looks, degrees, as in ``mujoco.MjvCamera``.
    distance : float
        From what it looks at, m.
    fovy : float
        Vertical field of view, degrees.
    lookat : numpy.ndarray
        What it looks at in every state, m, [T, 3].
    """

    azimuth: float
    elevation: float
    distance: float
    fovy: float
    lookat: NDArray[np.float64]


def view(table: ClassTable, states: NDArray[np.float64], step_seconds: float) -> View:
    """Return the view of a walk, from the side of the camera that the robot file names, or else MuJoCo's own.

    Parameters
    ----------
    table : ClassTable
        The robot.
    states : numpy.ndarray
        Positions of all states, [T, nq].
    step_seconds : float
        Time between two of them, s.
    """
    model = table.models[0]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    body = data.xpos[table.main_body].copy()
    name = table.robot.spec.get("pictures", {}).get("camera")
    if name is None:
        free = mujoco.MjvCamera()
        mujoco.mjv_defaultFreeCamera(model, free)
        azimuth, elevation, distance = float(free.azimuth), float(free.elevation), float(free.distance)
        fovy, looked_at = float(model.vis.global_.fovy), np.array(free.lookat)
    else:
        camera = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name)
        ahead = -data.cam_xmat[camera].reshape(3, 3)[:, 2]
        azimuth = float(np.degrees(np.arctan2(ahead[1], ahead[0])))
        elevation = float(np.degrees(np.arcsin(ahead[2])))
        # The point of its line of sight that is next to the robot, so that it turns around the robot.
        distance = float(ahead @ (body - data.cam_xpos[camera]))
        fovy, looked_at = float(model.cam_fovy[camera]), data.cam_xpos[camera] + distance * ahead
    way = _way(table, data, states)
    smooth = _smoothed(way, max(1, round(_SMOOTHING_SECONDS / step_seconds)))
    # A camera that went up and down with the robot would hide that the robot does.
    smooth[:, 2] = np.median(way[:, 2])
    return View(azimuth, elevation, distance, fovy, smooth + (looked_at - body))


def _way(table: ClassTable, data: mujoco.MjData, states: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the position of the main body in every state, m, [T, 3]."""
    way = np.empty((len(states), 3))
    for row, state in zip(way, states, strict=True):
        data.qpos[:] = state
        mujoco.mj_kinematics(table.models[0], data)
        row[:] = data.xpos[table.main_body]
    return way


def _smoothed(way: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """Return means over windows around each entry, smaller ones towards both ends, [T, 3]."""
    sums = np.vstack([np.zeros(3), np.cumsum(way, axis=0)])
    index = np.arange(len(way))
    half = np.minimum.reduce([np.full(len(way), window // 2), index, len(way) - 1 - index])
    means: NDArray[np.float64] = (sums[index + half + 1] - sums[index - half]) / (2 * half + 1)[:, None]
    return means
