"""Missing shank: the lowest segment of the limb has broken off, except for a stump."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, TypeAlias

import mujoco
import numpy as np

from dappo_batch._core import ConfigError
from dappo_batch.damage.base import DamageType
from dappo_batch.damage.reference_pose import ReferencePose
from dappo_batch.damage.segment import Segment, Stump, check_attachments, collides, rigid_bodies
from dappo_batch.damage.shrink import ends, half_length, require_no_frame

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dappo_batch.robots import Limb

    Vector: TypeAlias = NDArray[np.float64]

__all__ = ["MissingShank"]

_STUMP = 0.1
"""Share of the segment that remains by default."""


@dataclass(frozen=True)
class MissingShank(DamageType):
    """A lowest segment (everything below the last joint) that is shortened to a stump.

    Its length moves linearly with the severity, from the healthy one to that of the stump. It is measured
    along the segment, from the joint to the far end of what can touch the floor, without round ends. If
    ``toe_geom`` of the limb is a capsule, it is that of the capsule, whose end at the joint stays.

    - Geoms (spheres, capsules, cylinders, ellipsoids, boxes) that reach beyond the stump are shortened. Those
      that lie beyond it, such as a foot, shrink into the joint, a thousandth of their size at severity 1; if
      the stump has nothing else that can touch the floor, they become its end, in proportion smaller.
    - Meshes without contacts become invisible; meshes with contacts become capsules.
    - The mass of geoms goes with their volume. The mass of an ``<inertial>`` (or of meshes) is contracted
      along the segment by f, the share of the length that is left: the mass m becomes f m; its center c, as
      seen from the joint, c - (1 - f) (c·d) d for the direction d of the segment; and its second moments are
      multiplied by f³ along d and by f across it. That is exact for a link of uniform cross-section that
      begins at the joint.
    - Sites move with the end. The limb's touch signal reads 0 at every severity.

    Joints further out, and constraints or tendons that are attached to the segment, are errors.

    Attributes
    ----------
    half_length : float or None
        Half-length of the stump at severity 1, in metres, without round ends; by default a tenth of the
        segment's.
    """

    half_length: float | None = None

    name: ClassVar[str] = "missing_shank"
    disables_touch: ClassVar[bool] = True
    removes_parts: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_half_length(self.half_length, self.name)

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        """Shorten the lowest segment of the limb; see `DamageType.apply`."""
        link, toe = self._link(spec, limb)
        bodies, hanging = rigid_bodies(link)
        if hanging:
            joint = hanging[0].joints[0].name or "(unnamed)"
            what = f"geom {toe.name}" if toe else f"joint {limb.joints[-1]}"
            raise ConfigError(
                f"missing_shank: joint {joint} is below {what}, so that is not the lowest segment; list all"
                " joints of the limb, and set toe_geom to a geom of the lowest segment"
            )
        check_attachments(spec, bodies, self.name)
        pose = ReferencePose(spec, self.name)
        capsule = toe if toe and toe.type == mujoco.mjtGeom.mjGEOM_CAPSULE else None
        if capsule:
            segment = _along(spec, pose, tuple(bodies), capsule)
        else:
            segment = self._to_the_tip(spec, pose, limb, tuple(bodies), toe)
        least = stump_length(self.half_length, segment.length, f"limb {limb.name}", self.name)
        Stump(spec, pose, segment, least, severity, self.name).apply(limb, capsule)

    def _link(self, spec: mujoco.MjSpec, limb: Limb) -> tuple[mujoco.MjsBody, mujoco.MjsGeom | None]:
        """Return the body of the last joint, and the limb's toe if it has one."""
        if limb.toe_geom is None:
            joint = spec.joint(limb.joints[-1])
            if joint is None:
                raise ConfigError(
                    f"missing_shank: limb {limb.name}: the MJCF has no joint {limb.joints[-1]!r}"
                )
            return joint.parent, None
        toe = spec.geom(limb.toe_geom)
        if toe is None:
            raise ConfigError(f"missing_shank: limb {limb.name}: the MJCF has no geom {limb.toe_geom!r}")
        link = toe.parent
        while not link.joints and link.name != limb.body:
            link = link.parent
        return link, toe

    def _to_the_tip(
        self,
        spec: mujoco.MjSpec,
        pose: ReferencePose,
        limb: Limb,
        bodies: tuple[mujoco.MjsBody, ...],
        toe: mujoco.MjsGeom | None,
    ) -> Segment:
        """Return the segment from the joint to its geom that is farthest from that, or to the limb's toe."""
        link = bodies[0]
        start = pose.anchor(link.joints[0]) if link.joints else pose.from_body(link, np.zeros(3))
        geoms = [geom for body in bodies for geom in body.geoms]
        geoms = [geom for geom in geoms if geom == toe or collides(spec, geom)] or geoms
        arms = [pose.box(geom)[0] - start for geom in ([toe] if toe else geoms)]
        arm = max(arms, key=np.linalg.norm, default=np.zeros(3))
        distance = float(np.linalg.norm(arm))
        if distance < _SHORTEST:
            raise ConfigError(
                f"missing_shank: limb {limb.name} has no geom away from its joint {limb.joints[-1]}, so its"
                " lowest segment has no length"
            )
        length = max(pose.interval(geom, start, arm / distance)[1] for geom in geoms)
        return Segment(bodies, start, arm / distance, length)


_SHORTEST = 1e-3
"""Least distance of a geom from the joint, m."""


def check_half_length(half: float | None, owner: str) -> None:
    """Raise if the parameter ``half_length`` is not a length."""
    if half is not None and not (math.isfinite(half) and half > 0):
        raise ConfigError(f"{owner}: half_length must be above 0, got {half}")


def stump_length(half: float | None, length: float, what: str, owner: str) -> float:
    """Return the length of the stump at severity 1.

    Raises
    ------
    ConfigError
        If the stump is not shorter than the segment.
    """
    if half is None:
        return _STUMP * length
    if 2 * half >= length:
        raise ConfigError(f"{owner}: half_length must be below the {length / 2:.6g} m of {what}, got {half}")
    return 2 * half


def _along(
    spec: mujoco.MjSpec, pose: ReferencePose, bodies: tuple[mujoco.MjsBody, ...], capsule: mujoco.MjsGeom
) -> Segment:
    """Return the segment along a capsule."""
    require_no_frame(capsule, MissingShank.name)
    body = capsule.parent
    anchor = np.asarray(body.joints[0].pos if body.joints else np.zeros(3))
    near, far = ends(spec, capsule)
    if np.linalg.norm(far - anchor) < np.linalg.norm(near - anchor):
        near, far = far, near
    start = pose.from_body(body, near)
    arm = pose.from_body(body, far) - start
    return Segment(bodies, start, arm / np.linalg.norm(arm), 2 * half_length(capsule))
