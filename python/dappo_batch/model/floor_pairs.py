"""Explicit floor contacts: the same physics as the contacts of the MJCF, with faster collision detection.

A robot that can only be in contact with the world needs no broad phase. Its contacts become explicit pairs of
geoms, with the parameters that MuJoCo would mix.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np

from dappo_batch.robots.contact_masks import is_static, masks_match, touches_itself

__all__ = ["make_floor_contacts_explicit"]


class _ContactParameters(NamedTuple):
    """Contact parameters of a geom."""

    condim: int
    priority: int
    margin: float
    solmix: float
    friction: tuple[float, ...]
    solref: tuple[float, ...]
    solimp: tuple[float, ...]


class _Mixed(NamedTuple):
    """Mixed parameters of a contact of two geoms."""

    condim: int
    margin: float
    friction: tuple[float, ...]
    solref: tuple[float, ...]
    solimp: tuple[float, ...]


def make_floor_contacts_explicit(spec: mujoco.MjSpec) -> bool:
    """Replace dynamic contacts by explicit pairs, if that changes only the speed.

    This requires that all possible contacts are between the world and the robot. A robot keeps its contacts
    if its contact masks allow self-collisions, or if its MJCF already has pairs, excludes a contact that
    would otherwise be possible, or uses a feature of contacts that pairs cannot express.

    With a single kinematic tree there is at most one constraint island, so the search for islands is disabled
    too.

    Parameters
    ----------
    spec : mujoco.MjSpec
        The robot, edited in place. Unnamed geoms receive names.

    Returns
    -------
    bool
        Whether the contacts were replaced.
    """
    enabled = spec.option.enableflags
    special = mujoco.mjtEnableBit.mjENBL_OVERRIDE | mujoco.mjtEnableBit.mjENBL_SLEEP
    if enabled & special or spec.pairs or spec.flexes:
        return False
    world = [geom for geom in spec.geoms if is_static(geom.parent)]
    robot = [geom for geom in spec.geoms if not is_static(geom.parent)]
    if (
        any(map(_is_special, spec.geoms))
        or touches_itself(robot)
        or any(_keeps_apart(spec, item) for item in spec.excludes)
    ):
        return False

    contacts = [(a, b) for a in world for b in robot if masks_match(a, b)]
    for index, geom in enumerate(spec.geoms):
        geom.name = geom.name or f"geom {index}"
    for a, b in contacts:
        mixed = _mix(_parameters(a), _parameters(b))
        pair = spec.add_pair(
            geomname1=a.name, geomname2=b.name, condim=mixed.condim, margin=mixed.margin, gap=0.0
        )
        pair.friction = mixed.friction
        pair.solref = mixed.solref
        pair.solimp = mixed.solimp
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
    if sum(_is_root(body) for body in spec.bodies) == 1:
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    return True


def _is_root(body: mujoco.MjsBody) -> bool:
    """Return whether a body is the root of a kinematic tree: it can move and no body above it can."""
    return not is_static(body) and is_static(body.parent)


def _is_special(geom: mujoco.MjsGeom) -> bool:
    """Return whether a geom has a contact parameter that this module does not mix."""
    is_odd = any(_is_set(getattr(geom, key, 0.0)) for key in ("gap", "adhesion", "surfacevel"))
    # In `_mix` the ball would not be in contact with the plane.
    return is_odd or not geom.margin >= 0


def _is_set(value: float | np.ndarray) -> bool:
    """Return whether a number, or an entry of an array, is not 0: `np.any` takes ten times as long."""
    return bool(value.any() if isinstance(value, np.ndarray) else value)


def _keeps_apart(spec: mujoco.MjSpec, exclude: mujoco.MjsExclude) -> bool:
    """Return whether an exclusion forbids a contact that the masks of floor and robot allow."""
    one, other = spec.body(exclude.bodyname1), spec.body(exclude.bodyname2)
    if one is None or other is None:
        return True  # the compiler reports the missing body
    if is_static(one) == is_static(other):
        return False
    return any(masks_match(a, b) for a in one.geoms for b in other.geoms)


def _parameters(geom: mujoco.MjsGeom) -> _ContactParameters:
    return _ContactParameters(
        condim=int(geom.condim),
        priority=int(geom.priority),
        margin=float(geom.margin),
        solmix=float(geom.solmix),
        friction=tuple(geom.friction.tolist()),
        solref=tuple(geom.solref.tolist()),
        solimp=tuple(geom.solimp.tolist()),
    )


@lru_cache(maxsize=256)
def _mix(a: _ContactParameters, b: _ContactParameters) -> _Mixed:
    """Return the contact parameters that MuJoCo mixes from those of two geoms, from a simulated contact.

    The rules (priority, weights, sums, maxima) may change between versions of MuJoCo. The contact of a ball
    and a plane has those of the installed version.
    """
    spec = mujoco.MjSpec()
    spec.compiler.usethread = False
    plane = spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1, 1, 1])
    body = spec.worldbody.add_body(pos=[0, 0, 0.5])
    body.add_freejoint()
    ball = body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1, 0, 0])
    for geom, parameters in ((plane, a), (ball, b)):
        for key, value in parameters._asdict().items():
            setattr(geom, key, value)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    contact = data.contact[0]
    return _Mixed(
        condim=int(contact.dim),
        margin=float(contact.includemargin),
        friction=tuple(contact.friction.tolist()),
        solref=tuple(contact.solref.tolist()),
        solimp=tuple(contact.solimp.tolist()),
    )
