"""Size and path of a robot, to which camera, floor and shadows are fitted."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dappo_batch.model import ClassTable

__all__ = ["Extent", "extent"]

_SAMPLES = 20  # measured states of an episode
_DRAWN_GROUPS = 3  # MuJoCo draws the geoms of groups 0, 1 and 2
_CORNERS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, 8).T


@dataclass(frozen=True, eq=False)
class Extent:
    """Size and path of a robot.

    Attributes
    ----------
    path : numpy.ndarray
        Position of the main body in every state, m, [T, 3].
    samples : numpy.ndarray
        The states in which the robot was measured, [S].
    corners : numpy.ndarray
        Corners of the bounding boxes of all that is drawn of the robot, in these states, m, [S, C, 3].
    reach : float
        Radius of a sphere around the main body that holds them, m.
    middle : float
        Height of the centre of that sphere above the main body, m.
    limbs : numpy.ndarray
        Mean horizontal direction from the main body to each limb, of length 1; 0 for a limb below the main
        body. [L, 2]
    """

    path: NDArray[np.float64]
    samples: NDArray[np.intp]
    corners: NDArray[np.float64]
    reach: float
    middle: float
    limbs: NDArray[np.float64]


def extent(table: ClassTable, states: NDArray[np.float64]) -> Extent:
    """Measure the healthy robot in the states of an episode, [T, nq]."""
    model, main = table.models[0], table.main_body
    data = mujoco.MjData(model)
    geoms = _drawn(table)
    path = np.empty((len(states), 3))
    samples = np.unique(np.linspace(0, len(states) - 1, _SAMPLES).astype(int))
    boxes, limbs = [], []
    for index, state in enumerate(states):
        data.qpos[:] = state
        mujoco.mj_kinematics(model, data)
        path[index] = data.xpos[main]
        if index in samples:
            boxes.append(_corners(model, data, geoms))
            centres = [data.xipos[list(bodies)].mean(axis=0) for bodies in table.limb_bodies]
            limbs.append(np.array(centres)[:, :2] - path[index, :2])
    corners = np.array(boxes)
    offsets = corners - path[samples][:, None]
    middle = float(np.median((offsets[..., 2].min(axis=1) + offsets[..., 2].max(axis=1)) / 2))
    reach = float(np.linalg.norm(offsets - [0.0, 0.0, middle], axis=2).max())
    outwards = np.mean(limbs, axis=0)
    lengths = np.linalg.norm(outwards, axis=1, keepdims=True)
    outwards = np.divide(outwards, lengths, out=np.zeros_like(outwards), where=lengths > 0.02 * reach)
    return Extent(path, samples, corners, reach, middle, outwards)


def _drawn(table: ClassTable) -> NDArray[np.intp]:
    """Return the geoms of the robot that are drawn; all of them if none is."""
    model = table.models[0]
    of_robot = model.body_rootid[model.geom_bodyid] == model.body_rootid[table.main_body]
    drawn = of_robot & (model.geom_group < _DRAWN_GROUPS) & (model.geom_rgba[:, 3] > 0)
    return np.flatnonzero(drawn if drawn.any() else of_robot)


def _corners(model: mujoco.MjModel, data: mujoco.MjData, geoms: NDArray[np.intp]) -> NDArray[np.float64]:
    """Return the corners of the bounding boxes of geoms, m, [8 G, 3]."""
    centre, half = model.geom_aabb[geoms, :3], model.geom_aabb[geoms, 3:]
    local = centre[:, None] + half[:, None] * _CORNERS
    turned = np.einsum("gij,gcj->gci", data.geom_xmat[geoms].reshape(-1, 3, 3), local)
    corners: NDArray[np.float64] = (data.geom_xpos[geoms][:, None] + turned).reshape(-1, 3)
    return corners
