"""Missing toe: the lowest segment of the limb has broken off, except for a stump."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, TypeAlias

import mujoco
import numpy as np

from dappo_batch._core import ConfigError
from dappo_batch.damage.base import DamageType
from dappo_batch.damage.stump import Cut, carry_along

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dappo_batch.robots import Limb

    Vector: TypeAlias = NDArray[np.float64]

__all__ = ["MissingToe"]


@dataclass(frozen=True)
class MissingToe(DamageType):
    """A lowest segment, which must be a capsule, that is shortened.

    The half-length moves linearly with the severity, from the healthy one to `half_length`. The end at the
    joint, the direction and the radius stay. The compiler derives mass and inertia from the density; a mass
    written in the MJCF is scaled by the capsule's volume. A capsule-shaped touch site shrinks in proportion,
    and the limb's touch signal reads 0 at every severity.

    Other parts at the end of the segment (a foot, a site or a rigidly fixed body) move to the end of the
    stump, with their mass; visual geoms are hidden. Other parts along the segment, joints further out, and
    constraints or tendons from outside that are attached to the segment are errors.

    Attributes
    ----------
    half_length : float
        Half-length of the stump's cylindrical part at severity 1, in metres, without the round ends.
    """

    half_length: float

    name: ClassVar[str] = "missing_toe"
    disables_touch: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not (math.isfinite(self.half_length) and self.half_length > 0):
            raise ConfigError(f"missing_toe: half_length must be above 0, got {self.half_length}")

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        """Shorten the limb's toe; see `DamageType.apply`."""
        if limb.toe_geom is None:
            raise ConfigError(
                f"missing_toe: limb {limb.name} has no toe_geom; add the geom of its lowest segment"
                " to the robot TOML"
            )
        geom = spec.geom(limb.toe_geom)
        if geom is None:
            raise ConfigError(f"missing_toe: limb {limb.name}: the MJCF has no geom {limb.toe_geom!r}")
        if geom.type != mujoco.mjtGeom.mjGEOM_CAPSULE:
            raise ConfigError(f"missing_toe: geom {geom.name} is not a capsule")
        if geom.parent.explicitinertial:
            # Only the shape would change, and the stump would keep the mass of the whole toe.
            raise ConfigError(
                f"missing_toe: body {geom.parent.name} has an <inertial>, let geoms define its mass"
            )
        if spec.compiler.settotalmass > 0:
            raise ConfigError(
                "missing_toe: the MJCF sets the total mass (settotalmass), so the rest of the robot would"
                " gain what the limb loses; scale the masses and densities in the MJCF instead"
            )
        full = _half_length(geom)
        if self.half_length >= full:
            raise ConfigError(
                f"missing_toe: half_length must be below the {full:.6g} m of geom {geom.name},"
                f" got {self.half_length}"
            )
        stump = full + severity * (self.half_length - full)
        radius = float(geom.size[0])
        site = None if limb.touch_site is None else spec.site(limb.touch_site)
        if site is not None and site.type != mujoco.mjtGeom.mjGEOM_CAPSULE:
            site = None
        near, direction = _axis(spec, geom)
        cut = Cut(near, direction, 2 * full, 2 * stump, 2 * self.half_length, radius)
        carry_along(spec, geom, site, cut)
        _shorten(spec, geom, stump)
        if not math.isnan(geom.mass):  # NaN: the MJCF has no mass, and the compiler uses the density
            geom.mass = geom.mass * _volume(radius, stump) / _volume(radius, full)
        if site is not None:
            _shorten(spec, site, _half_length(site) * stump / full)


def _volume(radius: float, half_length: float) -> float:
    """Return the volume of a capsule."""
    return math.pi * radius**2 * (2 * half_length + 4 / 3 * radius)


def _half_length(capsule: mujoco.MjsGeom | mujoco.MjsSite) -> float:
    if _has_fromto(capsule):
        return float(np.linalg.norm(capsule.fromto[3:] - capsule.fromto[:3])) / 2
    return float(capsule.size[1])


def _has_fromto(capsule: mujoco.MjsGeom | mujoco.MjsSite) -> bool:
    return not math.isnan(capsule.fromto[0])


def _axis(spec: mujoco.MjSpec, capsule: mujoco.MjsGeom | mujoco.MjsSite) -> tuple[Vector, Vector]:
    """Return a capsule's end at the joint and the direction to its other end, in the body's frame."""
    if capsule.frame is not None:
        raise ConfigError(f"missing_toe: {capsule.name} lies in a <frame>, place it in its body directly")
    joints = capsule.parent.joints
    anchor = np.asarray(joints[0].pos if joints else np.zeros(3))
    if _has_fromto(capsule):
        near, far = capsule.fromto[:3].copy(), capsule.fromto[3:].copy()
    else:
        arm = capsule.size[1] * _direction(spec, capsule)
        near, far = capsule.pos - arm, capsule.pos + arm
    if np.linalg.norm(far - anchor) < np.linalg.norm(near - anchor):
        near, far = far, near
    return near, (far - near) / np.linalg.norm(far - near)


def _shorten(spec: mujoco.MjSpec, capsule: mujoco.MjsGeom | mujoco.MjsSite, half_length: float) -> None:
    """Give a capsule a new half-length, keeping the end at the joint in place."""
    near, direction = _axis(spec, capsule)
    if _has_fromto(capsule):
        capsule.fromto = np.concatenate([near, near + 2 * half_length * direction])
    else:
        capsule.pos = near + half_length * direction
        capsule.size[1] = half_length


def _direction(spec: mujoco.MjSpec, capsule: mujoco.MjsGeom | mujoco.MjsSite) -> Vector:
    """Return the direction of a capsule's axis, its own z, in the body's frame."""
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
