"""Other parts of a segment that is shortened, such as feet, sites and covers.

No part may stay in the air. As all models of a class table have the same parts, those at the end of the
segment move with it instead of being removed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import mujoco
import numpy as np

from dappo_batch._core import ConfigError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Vector: TypeAlias = NDArray[np.float64]
    Part: TypeAlias = mujoco.MjsGeom | mujoco.MjsSite | mujoco.MjsBody

__all__ = ["Cut", "carry_along"]

_AT_THE_END = 0.75
"""Parts whose middle is beyond this share of the segment are at its end."""
_ROUNDING = 1e-9


@dataclass(frozen=True)
class Cut:
    """A shortened segment; lengths are between the centers of its round ends, m."""

    near: Vector
    """The end at the joint, in the frame of the segment's body."""
    direction: Vector
    length: float
    left: float
    """Length of the stump."""
    least: float
    """Length of the stump at severity 1."""
    radius: float


def carry_along(spec: mujoco.MjSpec, toe: mujoco.MjsGeom, site: mujoco.MjsSite | None, cut: Cut) -> None:
    """Move the parts at the end of a segment to the end of its stump.

    Parameters
    ----------
    spec : mujoco.MjSpec
        The robot, before the segment is shortened.
    toe : mujoco.MjsGeom
        The segment.
    site : mujoco.MjsSite or None
        A site that is shortened together with the segment.
    cut : Cut
        The shortened segment.

    Raises
    ------
    ConfigError
        If a part can neither stay nor move with the end.
    """
    body = toe.parent
    _check_attachments(spec, body)
    parts: list[Part] = [geom for geom in body.geoms if geom != toe]
    parts += [other for other in body.sites if other != site]
    parts += list(body.bodies)
    if not parts:
        return
    where = _Places(spec, toe, cut)
    moved: list[Part] = []
    for part, (low, high) in zip(parts, where.intervals(parts), strict=True):
        if high <= cut.least + cut.radius + _ROUNDING:
            continue
        if (low + high) / 2 >= _AT_THE_END * cut.length:
            moved.append(part)
            _shift(part, (cut.left - cut.length) * cut.direction)
        elif isinstance(part, mujoco.MjsSite):
            _shift(part, min(0.0, cut.left - high) * cut.direction)
        elif isinstance(part, mujoco.MjsGeom) and _is_for_looks(spec, part):
            part.rgba = [*part.rgba[:3], 0.0]
        else:
            kind = "body" if isinstance(part, mujoco.MjsBody) else "geom"
            raise ConfigError(
                f"missing_toe: {kind} {part.name or '(unnamed)'} lies along geom {toe.name} and would stay"
                f" in the air when that breaks off; make it part of {toe.name}, move it to the segment above,"
                " or use another damage type"
            )


class _Places:
    """Positions of the parts of the healthy robot along the segment."""

    def __init__(self, spec: mujoco.MjSpec, toe: mujoco.MjsGeom, cut: Cut) -> None:
        try:
            self.model = spec.copy().compile()
        except ValueError as error:
            raise ConfigError(f"missing_toe: the MJCF does not compile: {error}") from error
        self.data = mujoco.MjData(self.model)
        mujoco.mj_kinematics(self.model, self.data)
        self.name = toe.name
        self.body = int(self.model.geom(toe.name).bodyid[0])
        frame = self.data.xmat[self.body].reshape(3, 3)
        self.near = self.data.xpos[self.body] + frame @ cut.near
        self.direction = frame @ cut.direction

    def intervals(self, parts: list[Part]) -> list[tuple[float, float]]:
        """Return the interval of each part along the segment, from the end at the joint, m."""
        model = self.model
        # The compiler keeps the order of the parts of a body.
        geoms = iter(
            [i for i in np.flatnonzero(model.geom_bodyid == self.body) if i != model.geom(self.name).id]
        )
        bodies = iter(np.flatnonzero(model.body_parentid == self.body))
        found = []
        for part in parts:
            if isinstance(part, mujoco.MjsGeom):
                found.append(self._of_geom(int(next(geoms))))
            elif isinstance(part, mujoco.MjsSite):
                position = self.data.site_xpos[self._site(part)]
                found.append((self._along(position),) * 2)
            else:
                found.append(self._of_body(int(next(bodies))))
        return found

    def _site(self, part: mujoco.MjsSite) -> int:
        same_body = list(part.parent.sites)
        return int(np.flatnonzero(self.model.site_bodyid == self.body)[same_body.index(part)])

    def _along(self, position: Vector) -> float:
        return float((position - self.near) @ self.direction)

    def _of_geom(self, geom: int) -> tuple[float, float]:
        center, half = np.split(self.model.geom_aabb[geom], 2)
        axes = self.data.geom_xmat[geom].reshape(3, 3)
        middle = self._along(self.data.geom_xpos[geom] + axes @ center)
        reach = float(np.abs(self.direction @ axes) @ half)
        return middle - reach, middle + reach

    def _of_body(self, root: int) -> tuple[float, float]:
        model, inside = self.model, {root}
        for body in range(root + 1, model.nbody):
            if int(model.body_parentid[body]) in inside:
                inside.add(body)
        for body in inside:
            if model.body_jntnum[body]:
                joint = model.joint(int(model.body_jntadr[body])).name
                raise ConfigError(
                    f"missing_toe: joint {joint or '(unnamed)'} is below geom {self.name}, so that is not"
                    " the lowest segment; set toe_geom to the lowest one"
                )
        places = [
            self._of_geom(int(geom)) for body in inside for geom in np.flatnonzero(model.geom_bodyid == body)
        ]
        origin = self._along(self.data.xpos[root])
        places = places or [(origin, origin)]
        return min(low for low, _ in places), max(high for _, high in places)


def _shift(part: Part, way: Vector) -> None:
    if part.frame is not None:
        raise ConfigError(
            f"missing_toe: {part.name or 'an unnamed part'} at the end of the toe lies in a <frame>, place"
            " it in its"
            " body directly"
        )
    if not isinstance(part, mujoco.MjsBody) and not np.isnan(part.fromto[0]):
        part.fromto = np.asarray(part.fromto) + np.tile(way, 2)
    else:
        part.pos = np.asarray(part.pos) + way


def _is_for_looks(spec: mujoco.MjSpec, geom: mujoco.MjsGeom) -> bool:
    """Return whether a geom has neither contacts nor mass."""
    is_paired = geom.name != "" and any(geom.name in (pair.geomname1, pair.geomname2) for pair in spec.pairs)
    low, high = spec.compiler.inertiagrouprange
    is_massless = (
        geom.mass == 0 or (np.isnan(geom.mass) and geom.density == 0) or not low <= geom.group <= high
    )
    return bool(not geom.contype and not geom.conaffinity and not is_paired and is_massless)


def _check_attachments(spec: mujoco.MjSpec, body: mujoco.MjsBody) -> None:
    """Raise if a constraint or a tendon is attached to the segment."""
    inside = [body, *body.find_all("body")]
    names = {item.name for item in inside} | {site.name for item in inside for site in item.sites}
    names.discard("")
    bodies_and_sites = (mujoco.mjtObj.mjOBJ_BODY, mujoco.mjtObj.mjOBJ_XBODY, mujoco.mjtObj.mjOBJ_SITE)
    for equality in spec.equalities:
        if equality.objtype in bodies_and_sites and {equality.name1, equality.name2} & names:
            raise ConfigError(
                f"missing_toe: an equality constraint is attached to body {body.name}, whose end breaks off"
            )
    for tendon in spec.tendons:
        for wrap in tendon.path:
            if wrap.type in (mujoco.mjtWrap.mjWRAP_JOINT, mujoco.mjtWrap.mjWRAP_PULLEY):
                continue
            if wrap.target.parent in inside:
                raise ConfigError(
                    f"missing_toe: tendon {tendon.name} is attached to body {body.name}, whose end breaks off"
                )
