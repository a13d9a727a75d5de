"""The camera: its direction, its distance, and how it follows the robot."""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dappo_batch._checks import text
from dappo_batch._core import ConfigError
from dappo_batch.model import ClassTable
from dappo_batch.render.extent import Extent, extent

__all__ = ["AUTO", "SIDES", "View", "check_camera", "view"]

AUTO = "auto"
SIDES = {"left": 90.0, "right": -90.0, "front": 0.0, "back": 180.0}
"""Directions from the robot to the camera: degrees from +x towards +y."""

_HEADROOM = 0.15  # of the robot's reach, above it, where the caption is
_EDGES = (
    0.9,
    0.75,
    0.9,
)  # which the robot keeps within: sides, top and bottom; the edges of a frame are at 1
_SHARE = 0.9  # of the states in which it does: limbs may be stretched for a moment
_FOVY = 45.0  # degrees, MuJoCo's own
_ELEVATION = -22.0  # degrees
_BEARING = -120.0  # degrees: behind the robot on its right, so that it walks to the right in the picture
_BEARINGS = np.concatenate([np.arange(60.0, 121.0, 5.0), -np.arange(60.0, 121.0, 5.0)])
_CLEAREST = 50.0  # degrees between camera and limb: a limb that points at the camera looks short
# Averaging window of the path, so that the gait does not shake the picture.
_SMOOTHING_SECONDS = 1.0


@dataclass(frozen=True, eq=False)
class View:
    """A camera with a fixed direction that follows the robot, or a camera of the MJCF.

    Attributes
    ----------
    azimuth, elevation : float
        Direction of view, degrees, as in ``mujoco.MjvCamera``.
    distance : float
        Distance from the point of view, m.
    fovy : float
        Vertical field of view, degrees.
    lookat : numpy.ndarray
        Point of view in every state, m, [T, 3].
    reach : float
        Radius of a sphere around it that holds the robot, m.
    fixed : int
        Id of a camera of the MJCF, which moves as the MJCF says; -1 for one that follows.
    """

    azimuth: float
    elevation: float
    distance: float
    fovy: float
    lookat: NDArray[np.float64]
    reach: float
    fixed: int = -1


def check_camera(table: ClassTable, camera: str) -> None:
    """Check that a robot can be seen from a camera, before the episode is simulated.

    Parameters
    ----------
    table : ClassTable
        The robot.
    camera : str
        ``"auto"``, a side (``"left"``, ``"right"``, ``"front"``, ``"back"``) or a camera of the MJCF.

    Raises
    ------
    ConfigError
        If there is no such camera.
    """
    model = table.models[0]
    names = [repr(name) for index in range(model.ncam) if (name := model.camera(index).name)]
    if text(camera, "camera") not in (AUTO, *SIDES) and _camera_id(model, camera) < 0:
        of_mjcf = f"or a camera of the MJCF: {', '.join(names)}" if names else "and the MJCF names no camera"
        raise ConfigError(f"camera is {camera!r}, expected {AUTO}, {', '.join(SIDES)}, {of_mjcf}")


def view(
    table: ClassTable,
    states: NDArray[np.float64],
    step_seconds: float,
    *,
    camera: str = AUTO,
    damage_class: int = 0,
    aspect: float = 4 / 3,
) -> View:
    """Return the view of an episode, which shows the whole robot and follows its main body.

    Parameters
    ----------
    table : ClassTable
        The robot.
    states : numpy.ndarray
        Positions of all states, [T, nq].
    step_seconds : float
        Time between two states, s.
    camera : str
        As in `check_camera`. ``"auto"`` is the side on which the limbs of `damage_class` are, and that of
        the camera in ``[pictures]`` of the robot TOML if nothing is damaged.
    damage_class : int
        The damage to be seen.
    aspect : float
        Width of a frame by its height.

    Raises
    ------
    ConfigError
        If there is no such camera.
    """
    check_camera(table, camera)
    seen = extent(table, states)
    bearing, elevation = _usual(table, camera)
    if camera == AUTO:
        limbs = [limb for limb, _ in table.space.classes[damage_class].damages]
        bearing = _towards(seen.limbs[limbs], bearing)
    elif camera in SIDES:
        bearing = SIDES[camera]
    azimuth, lookat = (bearing + 360.0) % 360.0 - 180.0, _lookat(seen, step_seconds)
    return View(
        azimuth=azimuth,
        elevation=elevation,
        distance=_distance(seen, lookat, (math.radians(azimuth), math.radians(elevation)), aspect),
        fovy=_FOVY,
        lookat=lookat,
        reach=seen.reach,
        fixed=-1 if camera in (AUTO, *SIDES) else _camera_id(table.models[0], camera),
    )


def _distance(
    seen: Extent, lookat: NDArray[np.float64], direction: tuple[float, float], aspect: float
) -> float:
    """Return the least distance from which all of the robot is within the edges of the frame, m."""
    azimuth, elevation = direction
    right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    ahead = np.array([-right[1] * math.cos(elevation), right[0] * math.cos(elevation), math.sin(elevation)])
    points = seen.corners - lookat[seen.samples][:, None]
    across, height, depth = points @ right, points @ np.cross(right, ahead), points @ ahead
    sides, top, bottom = math.tan(math.radians(_FOVY / 2)) * np.array(_EDGES)
    # A point at a depth beyond the place that is looked at is seen at the angle offset / (distance + depth).
    needed = np.maximum.reduce([np.abs(across) / (sides * aspect), height / top, -height / bottom]) - depth
    return float(np.quantile(needed.max(axis=1), _SHARE))


def _camera_id(model: mujoco.MjModel, name: str) -> int:
    return int(mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_CAMERA, name))


def _usual(table: ClassTable, camera: str) -> tuple[float, float]:
    """Return bearing and elevation of a camera of the MJCF, or of that of a healthy robot, degrees."""
    name = table.robot.spec.get("pictures", {}).get("camera") if camera in (AUTO, *SIDES) else camera
    if name is None:
        return _BEARING, _ELEVATION
    model = table.models[0]
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    back = data.cam_xmat[_camera_id(model, name)].reshape(3, 3)[:, 2]
    elevation = -math.degrees(math.asin(min(1.0, max(-1.0, back[2]))))
    return math.degrees(math.atan2(back[1], back[0])), elevation


def _towards(limbs: NDArray[np.float64], usual: float) -> float:
    """Return a bearing from which limbs in some directions, [K, 2], are on the near side and not end-on."""
    limbs = limbs[np.any(limbs != 0, axis=1)]
    if len(limbs) == 0:
        return usual
    candidates = np.radians(_BEARINGS)
    cosines = np.stack([np.cos(candidates), np.sin(candidates)], axis=1) @ limbs.T
    angles = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
    worst = np.abs(angles - _CLEAREST).max(axis=1).round(3)
    turn = np.abs((_BEARINGS - usual + 180.0) % 360.0 - 180.0)
    return float(_BEARINGS[np.lexsort((turn, worst))[0]])


def _lookat(seen: Extent, step_seconds: float) -> NDArray[np.float64]:
    """Return the point of view of a following camera in every state, m, [T, 3]."""
    smooth = _smoothed(seen.path, max(1, round(_SMOOTHING_SECONDS / step_seconds)))
    if np.ptp(smooth[:, 2]) < seen.reach:
        # The camera keeps its height, so that vertical motion of the robot is visible.
        smooth[:, 2] = np.median(seen.path[:, 2])
    smooth[:, 2] += seen.middle + _HEADROOM * seen.reach
    return smooth


def _smoothed(path: NDArray[np.float64], window: int) -> NDArray[np.float64]:
    """Return means over windows around each entry, smaller ones towards both ends, [T, 3]."""
    sums = np.vstack([np.zeros(3), np.cumsum(path, axis=0)])
    index = np.arange(len(path))
    half = np.minimum.reduce([np.full(len(path), window // 2), index, len(path) - 1 - index])
    means: NDArray[np.float64] = (sums[index + half + 1] - sums[index - half]) / (2 * half + 1)[:, None]
    return means
