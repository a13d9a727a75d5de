"""Missing limb: the whole limb has broken off, except for a stump at its first joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, TypeAlias

import mujoco
import numpy as np

from dappo_batch._core import ConfigError
from dappo_batch.damage.actuators import moves, scale_forces
from dappo_batch.damage.base import DamageType
from dappo_batch.damage.missing_shank import check_half_length, stump_length
from dappo_batch.damage.parts import joints_of
from dappo_batch.damage.reference_pose import ReferencePose
from dappo_batch.damage.segment import GONE, Segment, Stump, check_attachments, collides, rigid_bodies
from dappo_batch.damage.shrink import is_mesh, make_capsule, require_no_frame, scale_about, set_inertial
from dappo_batch.robots.contact_masks import is_static, masks_match

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from dappo_batch.robots import Limb

    Vector: TypeAlias = NDArray[np.float64]

__all__ = ["MissingLimb"]

_MASS_GONE = 1e-4
"""Mass of the bodies beyond the stump at severity 1, as a share of theirs; bodies that move need one."""
_SHORTEST = 1e-3
"""Least length of a segment, m."""
_MASKS = 31
"""Bits of a contact mask."""


@dataclass(frozen=True)
class MissingLimb(DamageType):
    """A limb that ends in a stump of its first segment.

    The first segment, from the first joint to the next one, is shortened as the lowest one in
    `MissingShank`. Everything beyond it moves to the end of the stump and shrinks, linearly with the
    severity, to a thousandth of its size and a ten-thousandth of its mass, and touches no other part of the
    robot. Actuators of the limb lose their torque. The joints remain as degrees of freedom without effect
    on the robot: the inertia that the limb had around each becomes armature of the joint, so that it moves
    no faster than before, and every integrator remains stable.

    The limb's touch signal reads 0 at every severity. Constraints or tendons that are attached to the limb
    are errors.

    Attributes
    ----------
    half_length : float or None
        Half-length of the stump at severity 1, in metres, without round ends; by default a tenth of the
        first segment's.
    """

    half_length: float | None = None

    name: ClassVar[str] = "missing_limb"
    disables_touch: ClassVar[bool] = True
    removes_parts: ClassVar[bool] = True

    def __post_init__(self) -> None:
        check_half_length(self.half_length, self.name)

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        """Shrink the limb to a stump; see `DamageType.apply`."""
        first = spec.joint(limb.joints[0])
        if first is None:
            raise ConfigError(f"missing_limb: limb {limb.name}: the MJCF has no joint {limb.joints[0]!r}")
        links = _links(first.parent)
        check_attachments(spec, [body for bodies in links for body in bodies], self.name)
        pose = ReferencePose(spec, self.name)
        segment = _first_segment(pose, first, links)
        least = stump_length(self.half_length, segment.length, f"limb {limb.name}", self.name)
        if any(moves(spec, actuator, limb, self.name) for actuator in spec.actuators):
            scale_forces(spec, limb, 1 - severity, self.name)
        for joint in joints_of(spec, limb):
            joint.armature += severity * (pose.joint_inertia(joint) - joint.armature)
        stump = Stump(spec, pose, segment, least, severity, self.name)
        stump.apply(limb)
        _move_children(pose, segment.bodies, segment.start, stump.share, self.name)
        lost = [body for bodies in links[1:] for body in bodies]
        _touch_only_the_world(spec, [geom for body in lost for geom in body.geoms])
        for bodies in links[1:]:
            self._shrink(spec, pose, bodies, severity)

    def _shrink(
        self, spec: mujoco.MjSpec, pose: ReferencePose, bodies: list[mujoco.MjsBody], severity: float
    ) -> None:
        """Shrink the bodies of a link towards its joint."""
        anchor = pose.anchor(bodies[0].joints[0])
        size, share = 1 + severity * (GONE - 1), 1 + severity * (_MASS_GONE - 1)
        _move_children(pose, bodies, anchor, size, self.name)
        for body in bodies:
            point = pose.to_body(body, anchor)
            mass, center, tensor = pose.inertial(body)
            if mass > 0:
                center = point + size * (pose.to_body(body, center) - point)
                set_inertial(spec, body, share * mass, center, share * size**2 * tensor)
            for geom in body.geoms:
                if is_mesh(geom):
                    if not collides(spec, geom):
                        geom.rgba = [*geom.rgba[:3], 0.0]
                        continue
                    require_no_frame(geom, self.name)
                    make_capsule(geom, pose)
                require_no_frame(geom, self.name)
                scale_about(geom, point, size)
            for site in body.sites:
                require_no_frame(site, self.name)
                scale_about(site, point, size)


def _links(link: mujoco.MjsBody) -> list[list[mujoco.MjsBody]]:
    """Return the bodies from a link outwards, in one list for each joint that moves them."""
    found = []
    roots = [link]
    for root in roots:  # grows in the loop
        fixed, hanging = rigid_bodies(root)
        found.append(fixed)
        roots += hanging
    return found


def _first_segment(pose: ReferencePose, joint: mujoco.MjsJoint, links: list[list[mujoco.MjsBody]]) -> Segment:
    """Return the segment from a joint to the next one that is not at the same place, or to a geom."""
    start = pose.anchor(joint)
    ends = [pose.anchor(bodies[0].joints[0]) for bodies in links[1:]]
    ends += [pose.box(geom)[0] for bodies in links for body in bodies for geom in body.geoms]
    for end in ends:
        length = float(np.linalg.norm(end - start))
        if length >= _SHORTEST:
            return Segment(tuple(links[0]), start, (end - start) / length, length)
    raise ConfigError(f"missing_limb: joint {joint.name} moves no geom away from it, so there is no limb")


def _move_children(
    pose: ReferencePose,
    bodies: tuple[mujoco.MjsBody, ...] | list[mujoco.MjsBody],
    point: Vector,
    factor: float,
    owner: str,
) -> None:
    """Move the joints that hang on some bodies towards a point, with all that they move."""
    for body in bodies:
        for child in body.bodies:
            if child.joints:
                require_no_frame(child, owner)
                way = (factor - 1) * (pose.anchor(child.joints[0]) - point)
                child.pos = np.asarray(child.pos) + pose.turned(body, way)


def _touch_only_the_world(spec: mujoco.MjSpec, lost: list[mujoco.MjsGeom]) -> None:
    """Take the contacts with moving geoms from some geoms, which may lie inside of others when they shrink.

    Masks alone change, and only where they allow such a contact: the geoms and the static geoms that they
    can touch get a bit of their own.
    """
    inside = set(lost)
    static = [geom for geom in spec.geoms if is_static(geom.parent)]
    moving = [geom for geom in spec.geoms if geom not in inside and not is_static(geom.parent)]
    if not any(masks_match(geom, other) for geom in lost for other in moving):
        return
    used = 0
    for geom in spec.geoms:
        used |= geom.contype | geom.conaffinity
    free = next((1 << bit for bit in range(_MASKS) if not used >> bit & 1), None)
    if free is None:
        raise ConfigError(
            f"missing_limb: the geoms use all {_MASKS} bits of contype and conaffinity; one must be free, or"
            " the robot must not touch itself ([simplify] self_collision = false)"
        )
    touched = {geom: [other for other in static if masks_match(geom, other)] for geom in lost}
    for geom, others in touched.items():
        geom.contype, geom.conaffinity = free if others else 0, 0
        for other in others:
            other.conaffinity |= free
