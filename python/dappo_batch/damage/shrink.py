"""Edits of geoms, sites and masses that make them smaller.

All models of a class table have the same parts with the same contacts. What breaks off is therefore not
removed but becomes so small that it has no effect. Directions of geoms never change.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, TypeAlias

import mujoco
import numpy as np

from dappo_batch._core import ConfigError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dappo_batch.damage.reference_pose import ReferencePose

    Vector: TypeAlias = NDArray[np.float64]
    Shape: TypeAlias = mujoco.MjsGeom | mujoco.MjsSite

__all__ = [
    "LEAST_SIZE",
    "ends",
    "half_length",
    "is_mesh",
    "make_capsule",
    "require_no_frame",
    "scale_about",
    "set_half_length",
    "set_inertial",
    "shorten_along",
]

_PRIMITIVES = (
    mujoco.mjtGeom.mjGEOM_SPHERE,
    mujoco.mjtGeom.mjGEOM_CAPSULE,
    mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    mujoco.mjtGeom.mjGEOM_CYLINDER,
    mujoco.mjtGeom.mjGEOM_BOX,
)
LEAST_SIZE = 1e-2
"""Least size of a shortened geom, as a share of its size."""
_LEAST_INERTIA = 1e-12
"""Above the least moment of inertia that MuJoCo accepts, kg m²."""


def is_mesh(geom: mujoco.MjsGeom) -> bool:
    """Return whether a geom has a shape that numbers of its own do not describe."""
    return geom.type not in _PRIMITIVES


def require_no_frame(part: Shape | mujoco.MjsBody, owner: str) -> None:
    """Raise if a part is placed relative to a frame of the MJCF instead of its body."""
    if part.frame is not None:
        raise ConfigError(
            f"{owner}: {part.name or 'an unnamed part'} breaks off and lies in a <frame>; place it in its"
            " body directly"
        )


def half_length(shape: Shape) -> float:
    """Return the half-length of a capsule, without its round ends."""
    if _has_fromto(shape):
        return float(np.linalg.norm(shape.fromto[3:] - shape.fromto[:3])) / 2
    return float(shape.size[1])


def ends(spec: mujoco.MjSpec, capsule: Shape) -> tuple[Vector, Vector]:
    """Return the centers of the round ends of a capsule in the frame of its body."""
    if _has_fromto(capsule):
        return capsule.fromto[:3].copy(), capsule.fromto[3:].copy()
    arm = capsule.size[1] * _direction(spec, capsule)
    return capsule.pos - arm, capsule.pos + arm


def set_half_length(capsule: mujoco.MjsGeom | mujoco.MjsSite, near: Vector, far: Vector, half: float) -> None:
    """Set the half-length of a capsule with ends `near` and `far`; the near end stays in place."""
    direction = (far - near) / np.linalg.norm(far - near)
    if isinstance(capsule, mujoco.MjsGeom) and not math.isnan(capsule.mass):
        # Without a mass in the MJCF (NaN) the compiler uses the density.
        radius = float(capsule.size[0])
        capsule.mass = capsule.mass * _volume(radius, half) / _volume(radius, half_length(capsule))
    if _has_fromto(capsule):
        _set_fromto(capsule, near, near + 2 * half * direction)
    else:
        capsule.pos = near + half * direction
        capsule.size[1] = half


def shorten_along(geom: mujoco.MjsGeom, axis: int, excess: float, toward: Vector) -> None:
    """Shorten a box, a cylinder or an ellipsoid along one of its axes.

    Parameters
    ----------
    geom : mujoco.MjsGeom
        The geom, edited in place.
    axis : int
        Index of the axis.
    excess : float
        Reduction of its half-size there, m.
    toward : array of shape [3]
        Direction of this axis in the frame of the body, towards the end that stays in place.
    """
    if _has_fromto(geom):  # its axis is the last one, and its half-size is not in `size`
        one, two = geom.fromto[:3].copy(), geom.fromto[3:].copy()
        near, far = (one, two) if (one - two) @ toward > 0 else (two, one)
        half = float(np.linalg.norm(far - near)) / 2
        left = max(half - excess, LEAST_SIZE * half)
        _set_fromto(geom, near, near + (far - near) * left / half)
    else:
        place = 1 if geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER else axis
        half = float(geom.size[place])
        left = max(half - excess, LEAST_SIZE * half)
        geom.size[place] = left
        geom.pos = np.asarray(geom.pos) + (half - left) * toward
    if not math.isnan(geom.mass):
        geom.mass = geom.mass * left / half


def scale_about(shape: Shape, point: Vector, factor: float) -> None:
    """Scale a primitive geom about a point in the frame of its body, its mass with its volume.

    Of a site the position alone: the zone of a touch sensor has to hold all contacts, with their margins.
    """
    if _has_fromto(shape):
        both = np.tile(point, 2)
        shape.fromto = both + factor * (np.asarray(shape.fromto) - both)
    else:
        shape.pos = point + factor * (np.asarray(shape.pos) - point)
    if isinstance(shape, mujoco.MjsGeom):
        shape.size = factor * np.asarray(shape.size)
        if not math.isnan(shape.mass):
            shape.mass = factor**3 * shape.mass


def make_capsule(geom: mujoco.MjsGeom, pose: ReferencePose) -> None:
    """Turn a mesh into the capsule along the longest axis of its bounding box, within that."""
    middle, axes, half = pose.box(geom)
    longest = int(np.argmax(half))
    radius = float(np.delete(half, longest).min())
    quat = np.zeros(4)
    mujoco.mju_quatZ2Vec(quat, pose.turned(geom.parent, axes[:, longest]))
    geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
    geom.meshname = ""
    geom.pos, geom.quat = pose.to_body(geom.parent, middle), quat
    geom.alt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    geom.size = [radius, max(half[longest] - radius, LEAST_SIZE * half[longest]), 0.0]


def set_inertial(
    spec: mujoco.MjSpec, body: mujoco.MjsBody, mass: float, center: Vector, tensor: NDArray[np.float64]
) -> None:
    """Write the mass distribution of a body into the MJCF, whatever defined it before.

    Parameters
    ----------
    spec : mujoco.MjSpec
        The robot, edited in place.
    body : mujoco.MjsBody
        The body.
    mass : float
        Its mass, kg.
    center : array of shape [3]
        Center of mass in the frame of the body, m.
    tensor : array of shape [3, 3]
        Inertia tensor about the center in the axes of the body, kg m².
    """
    modes = mujoco.mjtInertiaFromGeom
    if spec.compiler.inertiafromgeom == modes.mjINERTIAFROMGEOM_TRUE:
        # The compiler would ignore it. For all others it keeps ignoring theirs.
        spec.compiler.inertiafromgeom = modes.mjINERTIAFROMGEOM_AUTO
        for other in spec.bodies:
            if other.explicitinertial and other.geoms:
                other.explicitinertial = False
                other.ipos = [math.nan, 0.0, 0.0]
    moments, axes = (values[..., ::-1] for values in np.linalg.eigh(tensor))  # as MuJoCo, the largest first
    axes = axes * [1, 1, np.sign(np.linalg.det(axes))]
    quat = np.zeros(4)
    mujoco.mju_mat2Quat(quat, axes.flatten())
    body.explicitinertial = True
    body.mass = mass
    body.ipos = center
    body.inertia = np.maximum(moments, _LEAST_INERTIA)
    body.iquat = quat
    body.ialt.type = mujoco.mjtOrientation.mjORIENTATION_QUAT
    body.fullinertia = np.full(6, math.nan)


def _has_fromto(shape: Shape) -> bool:
    return not math.isnan(shape.fromto[0])


def _set_fromto(shape: Shape, near: Vector, far: Vector) -> None:
    """Move the far end of a shape; the order of its ends, and with it its direction, remains."""
    is_near_first = np.array_equal(shape.fromto[:3], near)
    shape.fromto = np.concatenate([near, far] if is_near_first else [far, near])


def _volume(radius: float, half: float) -> float:
    """Return the volume of a capsule."""
    return math.pi * radius**2 * (2 * half + 4 / 3 * radius)


def _direction(spec: mujoco.MjSpec, capsule: Shape) -> Vector:
    """Return the direction of a capsule's axis, its own z, in the frame of the body."""
    quat = np.asarray(capsule.quat, dtype=np.float64)
    if capsule.alt.type != mujoco.mjtOrientation.mjORIENTATION_QUAT:
        quat = np.asarray(
            spec.resolve_orientation(
                degree=capsule.compiler.degree, sequence=capsule.compiler.eulerseq, orientation=capsule.alt
            )
        )
    axis = np.zeros(3)
    mujoco.mju_rotVecQuat(axis, np.array([0.0, 0.0, 1.0]), quat / np.linalg.norm(quat))
    return axis
