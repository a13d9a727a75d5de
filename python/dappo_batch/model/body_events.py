"""Random lengths, masses and centres of mass of a robot, before it is compiled."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING, TypeAlias

import mujoco
import numpy as np

from dappo_batch._checks import listed
from dappo_batch._core import ConfigError, robot_body_events
from dappo_batch.damage.reference_pose import ReferencePose
from dappo_batch.damage.segment import collides
from dappo_batch.damage.shrink import half_length, is_mesh, require_no_frame, set_inertial

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from dappo_batch.robots import Robot

    Vector: TypeAlias = NDArray[np.float64]

__all__ = ["BodyEvents"]

_SHORTEST = 1e-3
"""Least length of a link, m."""
_SLANTED = 0.5
"""Cosine of the largest angle between a link and the axis along which a geom of it becomes longer."""
_ROUND = (mujoco.mjtGeom.mjGEOM_CAPSULE, mujoco.mjtGeom.mjGEOM_CYLINDER)
_FROM_GEOMS = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_TRUE


class BodyEvents:
    """The entries ``link_length``, ``mass`` and ``center_of_mass`` of a robot's ``[events]``.

    Attributes
    ----------
    names : tuple of str
        Names of the numbers of a variant.
    numbers : tuple of tuple of float
        The numbers of each variant, [V, numbers]; empty for a robot without such entries.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._events = robot_body_events(robot.toml_text)
        self.names = tuple(name for _, _, names, _ in self._events for name in names)
        of_events = [numbers for _, _, _, numbers in self._events]
        self.numbers: tuple[tuple[float, ...], ...] = tuple(
            tuple(number for row in rows for number in row) for rows in zip(*of_events, strict=True)
        )

    def variants(self, base: mujoco.MjSpec) -> list[mujoco.MjSpec]:
        """Return the robot in all variants, or `base` alone if it has none.

        Raises
        ------
        ConfigError
            If a pattern matches no body, or a body cannot be changed.
        """
        return [self._variant(base, index) for index in range(len(self.numbers))] or [base]

    def _variant(self, base: mujoco.MjSpec, index: int) -> mujoco.MjSpec:
        spec = base.copy()
        for kind, pattern, _, numbers in self._events:
            owner = f"robot {self._robot.name}: [events.{kind}]"
            if kind != "center_of_mass" and spec.compiler.settotalmass > 0:
                raise ConfigError(
                    f"{owner}: the MJCF sets the total mass (settotalmass), so that the masses of all bodies"
                    " would change; scale the masses in the MJCF instead"
                )
            _CHANGES[kind](spec, self._bodies(spec, pattern, owner), numbers[index], owner, self._robot)
        return spec

    def _bodies(self, spec: mujoco.MjSpec, pattern: str, owner: str) -> list[mujoco.MjsBody]:
        named = [body for body in spec.bodies if body.name and body != spec.worldbody]
        found = [body for body in named if re.fullmatch(pattern, body.name)]
        if not found:
            names = listed(body.name for body in named) or "none"
            raise ConfigError(f"{owner}: no body matches {pattern!r}; the robot has {names}")
        return found


def _scale_masses(
    spec: mujoco.MjSpec, bodies: Sequence[mujoco.MjsBody], numbers: Sequence[float], _: str, __: Robot
) -> None:
    """Scale masses and inertias, of inertials as of geoms."""
    (factor,) = numbers
    for body in bodies:
        if body.explicitinertial:
            body.mass *= factor
            body.inertia = factor * np.asarray(body.inertia)
            body.fullinertia = factor * np.asarray(body.fullinertia)  # NaN, if there is none, remains
        for geom in body.geoms:
            # The compiler uses the density if there is no mass (NaN).
            if math.isnan(geom.mass):
                geom.density *= factor
            else:
                geom.mass *= factor


def _move_centers(
    spec: mujoco.MjSpec, bodies: Sequence[mujoco.MjsBody], numbers: Sequence[float], owner: str, _: Robot
) -> None:
    """Move centres of mass; the inertia tensors about them remain."""
    offset = np.asarray(numbers)
    pose = ReferencePose(spec, owner)
    for body in bodies:
        if _has_inertial(spec, body):
            body.ipos = np.asarray(body.ipos) + offset
            continue
        mass, center, tensor = pose.inertial(body)
        if mass == 0:
            raise ConfigError(f"{owner}: body {body.name} has no mass")
        set_inertial(spec, body, mass, pose.to_body(body, center) + offset, tensor)


def _has_inertial(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> bool:
    """Return whether the mass of a body is that of its inertial, and not that of geoms."""
    return bool(body.explicitinertial and (spec.compiler.inertiafromgeom != _FROM_GEOMS or not body.geoms))


def _stretch(
    spec: mujoco.MjSpec, bodies: Sequence[mujoco.MjsBody], numbers: Sequence[float], owner: str, robot: Robot
) -> None:
    """Stretch links, each along the line from its joint to the next one."""
    (factor,) = numbers
    _check_equalities(spec, bodies, owner)
    for body in bodies:
        pose = ReferencePose(spec, owner)
        anchor = np.asarray(body.joints[0].pos, dtype=float) if body.joints else np.zeros(3)
        arm = _end(spec, body, pose, owner, robot) - anchor
        length = float(np.linalg.norm(arm))
        if length < _SHORTEST:
            raise ConfigError(f"{owner}: body {body.name} has no length: its joint is where the next one is")
        _Link(spec, pose, body, anchor, arm / length, factor, owner).stretch()


def _check_equalities(spec: mujoco.MjSpec, bodies: Sequence[mujoco.MjsBody], owner: str) -> None:
    for equality in spec.equalities:
        attached = next((body for body in bodies if body.name in (equality.name1, equality.name2)), None)
        if attached is not None and equality.objtype == mujoco.mjtObj.mjOBJ_BODY:
            raise ConfigError(
                f"{owner}: an equality constraint is attached to body {attached.name}, so that it cannot"
                " become longer"
            )


def _end(spec: mujoco.MjSpec, body: mujoco.MjsBody, pose: ReferencePose, owner: str, robot: Robot) -> Vector:
    """Return where a link ends, in the frame of its body: the next joint, the foot, or the farthest geom."""
    if len(body.bodies) > 1:
        raise ConfigError(
            f"{owner}: body {body.name} has {len(body.bodies)} bodies below it; a link has one at most"
        )
    if body.bodies:
        child = body.bodies[0]
        world = pose.anchor(child.joints[0]) if child.joints else pose.from_body(child, np.zeros(3))
        return pose.to_body(body, world)
    feet = {limb.foot for limb in robot.limbs}
    for geom in body.geoms:
        if geom.name and geom.name in feet:
            return pose.to_body(body, pose.box(geom)[0])
    for site in body.sites:
        if site.name and site.name in feet:
            return pose.to_body(body, pose.site(site))
    geoms = [geom for geom in body.geoms if collides(spec, geom)] or body.geoms
    middles = [pose.to_body(body, pose.box(geom)[0]) for geom in geoms]
    return max(middles, key=np.linalg.norm, default=np.zeros(3))


class _Link:
    """A body that becomes longer along a direction of its frame, away from an anchor that stays."""

    def __init__(
        self,
        spec: mujoco.MjSpec,
        pose: ReferencePose,
        body: mujoco.MjsBody,
        anchor: Vector,
        direction: Vector,
        factor: float,
        owner: str,
    ) -> None:
        self.spec, self.pose, self.body, self.owner = spec, pose, body, owner
        self.anchor, self.direction, self.factor = anchor, direction, factor
        self.map = np.eye(3) + (factor - 1) * np.outer(direction, direction)

    def stretch(self) -> None:
        """Move all that is on the body, and stretch its mass and its geoms."""
        if _has_inertial(self.spec, self.body):
            self._stretch_mass()
        for geom in self.body.geoms:
            self._stretch_geom(geom)
        for site in self.body.sites:
            require_no_frame(site, self.owner)
            if math.isnan(site.fromto[0]):
                site.pos = self._moved(site.pos)
            else:
                site.fromto = self._carried(site.fromto)
        for child in self.body.bodies:
            require_no_frame(child, self.owner)
            child.pos = self._moved(child.pos)

    def _moved(self, point: Sequence[float] | Vector) -> Vector:
        return np.asarray(self.anchor + self.map @ (np.asarray(point) - self.anchor))

    def _carried(self, fromto: Sequence[float] | Vector) -> Vector:
        """Return the ends of a shape that moves without becoming longer."""
        ends = np.asarray(fromto).reshape(2, 3)
        middle = ends.mean(axis=0)
        return np.asarray(ends + self._moved(middle) - middle).ravel()

    def _stretch_mass(self) -> None:
        """Stretch an inertial.

        A mass element dm at x becomes f dm at A x, for A = 1 + (f - 1) d dᵀ with the direction d: the mass
        becomes f m, and the second moments S = tr(I)/2 - I of the inertia tensor I become f A S A.
        """
        mass, center, tensor = self.pose.inertial(self.body)
        moments = self.factor * self.map @ (np.trace(tensor) / 2 * np.eye(3) - tensor) @ self.map
        center = self._moved(self.pose.to_body(self.body, center))
        tensor = np.trace(moments) * np.eye(3) - moments
        set_inertial(self.spec, self.body, self.factor * mass, center, tensor)

    def _stretch_geom(self, geom: mujoco.MjsGeom) -> None:
        require_no_frame(geom, self.owner)
        _, axes, _ = self.pose.box(geom)
        turned = np.array([self.pose.turned(self.body, axis) for axis in axes.T])
        cosines = np.abs(turned @ self.direction)
        axis = 2 if geom.type in _ROUND else int(np.argmax(cosines))
        is_long = not is_mesh(geom) and geom.type != mujoco.mjtGeom.mjGEOM_SPHERE
        is_long = is_long and bool(cosines[axis] >= _SLANTED)
        if not math.isnan(geom.fromto[0]):
            geom.fromto = self._carried(geom.fromto)
        else:
            geom.pos = self._moved(geom.pos)
        if is_long:
            self._lengthen(geom, axis)

    def _lengthen(self, geom: mujoco.MjsGeom, axis: int) -> None:
        """Lengthen a geom about its middle; a mass of its own grows with its volume."""
        is_capsule = geom.type == mujoco.mjtGeom.mjGEOM_CAPSULE
        if not math.isnan(geom.mass):
            ends = 4 / 3 * float(geom.size[0]) if is_capsule else 0.0
            length = 2 * half_length(geom) if is_capsule else 1.0
            geom.mass *= (self.factor * length + ends) / (length + ends)
        if not math.isnan(geom.fromto[0]):
            ends_of = np.asarray(geom.fromto).reshape(2, 3)
            middle = ends_of.mean(axis=0)
            geom.fromto = (middle + self.factor * (ends_of - middle)).ravel()
        else:
            geom.size[1 if geom.type in _ROUND else axis] *= self.factor


_CHANGES: dict[str, Callable[..., None]] = {
    "link_length": _stretch,
    "mass": _scale_masses,
    "center_of_mass": _move_centers,
}
