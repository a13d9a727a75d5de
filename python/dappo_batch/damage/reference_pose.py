"""Where the parts of the robot are before the damage, in the reference pose of the MJCF."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

import mujoco
import numpy as np

from dappo_batch._core import ConfigError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Vector: TypeAlias = NDArray[np.float64]
    Part: TypeAlias = mujoco.MjsBody | mujoco.MjsGeom | mujoco.MjsSite | mujoco.MjsJoint

__all__ = ["ReferencePose"]


class ReferencePose:
    """A compiled copy of a robot; positions and axes are in the frame of the world, m."""

    def __init__(self, spec: mujoco.MjSpec, owner: str) -> None:
        twin = spec.copy()
        try:
            self._model = twin.compile()
        except ValueError as error:
            raise ConfigError(f"{owner}: the MJCF does not compile: {error}") from error
        self._data = mujoco.MjData(self._model)
        mujoco.mj_kinematics(self._model, self._data)
        self._ids: dict[Part, int] = {}
        for body, other in zip(spec.bodies, twin.bodies, strict=True):
            self._ids[body] = other.id
            kinds = ((body.geoms, other.geoms), (body.sites, other.sites), (body.joints, other.joints))
            for parts, others in kinds:
                self._ids |= {part: same.id for part, same in zip(parts, others, strict=True)}

    def from_body(self, body: mujoco.MjsBody, point: Vector) -> Vector:
        """Return a point in the frame of a body as one of the world."""
        return np.asarray(self._data.xpos[self._ids[body]] + self._rotation(body) @ point)

    def to_body(self, body: mujoco.MjsBody, point: Vector) -> Vector:
        """Return a point of the world in the frame of a body."""
        return np.asarray(self.turned(body, point - self._data.xpos[self._ids[body]]))

    def turned(self, body: mujoco.MjsBody, direction: Vector) -> Vector:
        """Return a direction of the world in the frame of a body."""
        return np.asarray(self._rotation(body).T @ direction)

    def anchor(self, joint: mujoco.MjsJoint) -> Vector:
        """Return the anchor of a joint."""
        return np.array(self._data.xanchor[self._ids[joint]])

    def site(self, site: mujoco.MjsSite) -> Vector:
        """Return the position of a site."""
        return np.array(self._data.site_xpos[self._ids[site]])

    def box(self, geom: mujoco.MjsGeom) -> tuple[Vector, NDArray[np.float64], Vector]:
        """Return the middle, the axes (as columns) and the half-sizes of the box around a geom."""
        index = self._ids[geom]
        axes = np.array(self._data.geom_xmat[index].reshape(3, 3))
        center, half = np.split(self._model.geom_aabb[index], 2)
        return np.asarray(self._data.geom_xpos[index] + axes @ center), axes, np.array(half)

    def interval(self, geom: mujoco.MjsGeom, start: Vector, direction: Vector) -> tuple[float, float]:
        """Return the extent of a geom from a point along a direction; of round ends only their centers."""
        middle, axes, half = self.box(geom)
        if geom.type in (mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE):
            half = half - half.min()
        along, reach = float((middle - start) @ direction), float(np.abs(direction @ axes) @ half)
        return along - reach, along + reach

    def inertial(self, body: mujoco.MjsBody) -> tuple[float, Vector, NDArray[np.float64]]:
        """Return the mass of a body, its center in the world, and its inertia tensor in its own axes."""
        index = self._ids[body]
        axes = np.zeros(9)
        mujoco.mju_quat2Mat(axes, self._model.body_iquat[index])
        turn = axes.reshape(3, 3)
        tensor = turn @ np.diag(self._model.body_inertia[index]) @ turn.T
        mass = float(self._model.body_mass[index])
        return mass, self.from_body(body, self._model.body_ipos[index]), tensor

    def joint_inertia(self, joint: mujoco.MjsJoint) -> float:
        """Return the inertia that a joint moves, with its armature, kg m² or kg."""
        first = int(self._model.jnt_dofadr[self._ids[joint]])
        same = np.flatnonzero(self._model.dof_jntid == self._model.dof_jntid[first])
        return float(self._model.dof_M0[same].max())

    def _rotation(self, body: mujoco.MjsBody) -> NDArray[np.float64]:
        return np.asarray(self._data.xmat[self._ids[body]].reshape(3, 3))
