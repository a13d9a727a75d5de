"""Segments of a limb that are shortened to a stump."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import mujoco
import numpy as np

from dappo_batch._core import ConfigError
from dappo_batch.damage.shrink import (
    LEAST_SIZE,
    ends,
    half_length,
    is_mesh,
    make_capsule,
    require_no_frame,
    scale_about,
    set_half_length,
    set_inertial,
    shorten_along,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from dappo_batch.damage.reference_pose import ReferencePose
    from dappo_batch.robots import Limb

    Vector: TypeAlias = NDArray[np.float64]

__all__ = ["GONE", "Segment", "Stump", "check_attachments", "collides", "rigid_bodies"]

GONE = 1e-3
"""Size at severity 1 of what breaks off, as a share of its size."""
_SLANTED = 0.5
"""Cosine of the largest angle between a segment and the axis along which a geom of it is shortened."""
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Segment:
    """Bodies that move together, and the line along which they are shortened."""

    bodies: tuple[mujoco.MjsBody, ...]
    start: Vector
    """The end that stays, in the frame of the world."""
    direction: Vector
    length: float
    """From `start`, without round ends, m."""


def rigid_bodies(link: mujoco.MjsBody) -> tuple[list[mujoco.MjsBody], list[mujoco.MjsBody]]:
    """Return a body and those that are fixed to it, and the bodies that hang on these by joints."""
    fixed: list[mujoco.MjsBody] = [link]
    hanging: list[mujoco.MjsBody] = []
    for body in fixed:  # grows in the loop
        for child in body.bodies:
            (hanging if child.joints else fixed).append(child)
    return fixed, hanging


def collides(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
    """Return whether a geom can have contacts."""
    is_paired = geom.name != "" and any(geom.name in (pair.geomname1, pair.geomname2) for pair in spec.pairs)
    return bool(geom.contype or geom.conaffinity or is_paired)


class Stump:
    """Shortens a segment.

    Coordinates along the segment are 0 at its start and `segment.length` at its end. At severity 1 the stump
    ends at `least`, at other severities at `left`, which is the same share of the length as of the mass.

    Geoms within the stump remain. Those that reach beyond it are shortened along their axis that is nearest
    to the segment. Those beyond it break off: they shrink into the start, with their mass. If the stump has
    nothing else that can touch the floor, as in a robot whose feet alone touch it, they become its end
    instead, in proportion smaller. Meshes without contacts become invisible; those with contacts are replaced
    by capsules first.
    """

    def __init__(
        self,
        spec: mujoco.MjSpec,
        pose: ReferencePose,
        segment: Segment,
        least: float,
        severity: float,
        owner: str,
    ) -> None:
        self.spec, self.pose, self.segment, self.owner = spec, pose, segment, owner
        self.least = least
        self.left = segment.length + severity * (least - segment.length)
        self.share = self.left / segment.length
        lost = [geom for geom in self._geoms() if self._is_lost(geom)]
        rest = [geom for geom in self._geoms() if geom not in lost]
        touches = any(collides(spec, geom) for geom in rest)
        weighs = any(map(self._keeps_inertial, segment.bodies)) or any(map(self._has_mass, rest))
        self._lost = set(lost)
        self._lost_scale = 1 + severity * (GONE - 1) if touches and weighs else self.share

    def apply(self, limb: Limb, toe: mujoco.MjsGeom | None = None) -> None:
        """Shorten the segment.

        Parameters
        ----------
        limb : Limb
            The limb, for its touch site.
        toe : mujoco.MjsGeom, optional
            A capsule along the whole segment; its length becomes exactly that of the stump.
        """
        inertials = [body for body in self.segment.bodies if self._keeps_inertial(body)]
        for body in inertials:
            self._lighten(body)
        for geom in self._geoms():
            if geom == toe:
                set_half_length(geom, *self._ends(geom), self.left / 2)
            else:
                self._shorten(geom)
        for body in self.segment.bodies:
            for site in body.sites:
                self._place(site, site.name == limb.touch_site)

    def _geoms(self) -> list[mujoco.MjsGeom]:
        return [geom for body in self.segment.bodies for geom in body.geoms]

    def _interval(self, geom: mujoco.MjsGeom) -> tuple[float, float]:
        return self.pose.interval(geom, self.segment.start, self.segment.direction)

    def _is_lost(self, geom: mujoco.MjsGeom) -> bool:
        low, high = self._interval(geom)
        return low >= self.least - _ROUNDING and high > self.least + _ROUNDING

    def _has_mass(self, geom: mujoco.MjsGeom) -> bool:
        low, high = self.spec.compiler.inertiagrouprange
        is_massless = geom.mass == 0 or (np.isnan(geom.mass) and geom.density == 0)
        return bool(low <= geom.group <= high and not is_massless)

    def _keeps_inertial(self, body: mujoco.MjsBody) -> bool:
        """Return whether the mass of a body is that of an inertial, and not that of geoms that shrink."""
        mode = self.spec.compiler.inertiafromgeom
        if body.explicitinertial and (
            mode != mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE or not body.geoms
        ):
            return True
        return any(is_mesh(geom) and self._has_mass(geom) for geom in body.geoms)

    def _lighten(self, body: mujoco.MjsBody) -> None:
        """Contract the mass of a body along the segment.

        With f the share of the length that is left, a mass element dm at coordinate t becomes f dm at f t.
        For A = 1 - (1 - f) d dᵀ, d the direction, and the second moments S = tr(I)/2 - I of the inertia
        tensor I about the center c, the mass becomes f m, the center A c, and the second moments f A S A.
        """
        mass, center, tensor = self.pose.inertial(body)
        start = self.pose.to_body(body, self.segment.start)
        direction = self.pose.turned(body, self.segment.direction)
        squeeze = np.eye(3) - (1 - self.share) * np.outer(direction, direction)
        moments = self.share * squeeze @ (np.trace(tensor) / 2 * np.eye(3) - tensor) @ squeeze
        center = start + squeeze @ (self.pose.to_body(body, center) - start)
        set_inertial(self.spec, body, self.share * mass, center, np.trace(moments) * np.eye(3) - moments)

    def _shorten(self, geom: mujoco.MjsGeom) -> None:
        _, high = self._interval(geom)
        if high <= self.left + _ROUNDING and geom not in self._lost:
            return
        if is_mesh(geom):
            if not collides(self.spec, geom):
                geom.rgba = [*geom.rgba[:3], 0.0]
                return
            require_no_frame(geom, self.owner)
            make_capsule(geom, self.pose)
        require_no_frame(geom, self.owner)
        if geom in self._lost:
            self._scale(geom, self._lost_scale)
        elif geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE:
            self._shorten_capsule(geom)
        else:
            self._shorten_along(geom, high - self.left)

    def _scale(self, shape: mujoco.MjsGeom | mujoco.MjsSite, factor: float) -> None:
        scale_about(shape, self.pose.to_body(shape.parent, self.segment.start), factor)

    def _shorten_capsule(self, geom: mujoco.MjsGeom) -> None:
        """Move the far end of a capsule to the end of the stump; one that lies across shrinks instead."""
        near, far = self._ends(geom)
        start = self.pose.to_body(geom.parent, self.segment.start)
        direction = self.pose.turned(geom.parent, self.segment.direction)
        low, high = float((near - start) @ direction), float((far - start) @ direction)
        if high - low < _SLANTED * np.linalg.norm(far - near):
            self._scale(geom, self.share)
        elif high > self.left:
            left = max((self.left - low) / (high - low), LEAST_SIZE)
            set_half_length(geom, near, far, left * half_length(geom))

    def _ends(self, capsule: mujoco.MjsGeom | mujoco.MjsSite) -> tuple[Vector, Vector]:
        """Return the ends of a capsule in the frame of its body, first the one nearer to the start."""
        require_no_frame(capsule, self.owner)
        near, far = ends(self.spec, capsule)
        if (far - near) @ self.pose.turned(capsule.parent, self.segment.direction) < 0:
            near, far = far, near
        return near, far

    def _shorten_along(self, geom: mujoco.MjsGeom, excess: float) -> None:
        """Shorten a box, a cylinder or an ellipsoid; one that lies across the segment shrinks instead."""
        _, axes, _ = self.pose.box(geom)
        cosines = self.segment.direction @ axes
        axis = 2 if geom.type == mujoco.mjtGeom.mjGEOM_CYLINDER else int(np.argmax(np.abs(cosines)))
        if abs(cosines[axis]) < _SLANTED:
            self._scale(geom, self.share)
            return
        toward = -np.sign(cosines[axis]) * self.pose.turned(geom.parent, axes[:, axis])
        shorten_along(geom, axis, excess / (2 * abs(cosines[axis])), toward)

    def _place(self, site: mujoco.MjsSite, is_touch_site: bool) -> None:
        """Move a site with the end of the segment, and that of the touch sensor with its geoms."""
        if is_touch_site and site.type == mujoco.mjtGeom.mjGEOM_CAPSULE:
            half = half_length(site) * self.left / self.segment.length
            set_half_length(site, *self._ends(site), half)
            return
        along = float((self.pose.site(site) - self.segment.start) @ self.segment.direction)
        if along <= self.least + _ROUNDING:
            return
        require_no_frame(site, self.owner)
        self._scale(site, self._lost_scale if is_touch_site else self.share)


def check_attachments(spec: mujoco.MjSpec, bodies: Sequence[mujoco.MjsBody], owner: str) -> None:
    """Raise if a constraint or a tendon is attached to bodies that break off, or the total mass is fixed."""
    if spec.compiler.settotalmass > 0:
        raise ConfigError(
            f"{owner}: the MJCF sets the total mass (settotalmass), so the rest of the robot would"
            " gain what the limb loses; scale the masses and densities in the MJCF instead"
        )
    names = {body.name: body.name for body in bodies}
    names |= {site.name: body.name for body in bodies for site in body.sites}
    names.pop("", None)
    bodies_and_sites = (mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_SITE)
    for equality in spec.equalities:
        attached = [names[name] for name in (equality.name1, equality.name2) if name in names]
        if equality.objtype in bodies_and_sites and attached:
            raise ConfigError(
                f"{owner}: an equality constraint is attached to body {attached[0]}, which breaks off"
            )
    for tendon in spec.tendons:
        for wrap in tendon.path:
            if wrap.type in (mujoco.mjtWrap.mjWRAP_JOINT, mujoco.mjtWrap.mjWRAP_PULLEY):
                continue
            if wrap.target.parent in bodies:
                raise ConfigError(
                    f"{owner}: tendon {tendon.name} is attached to body {wrap.target.parent.name}, which"
                    " breaks off"
                )
