"""``[simplify]``: fewer contacts and simpler physics than in the MJCF, which remains unchanged."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from difflib import get_close_matches
from typing import Any

import mujoco

from dappo_batch._checks import listed
from dappo_batch.model.edits import EditLog
from dappo_batch.model.overrides import apply_overrides, can_collide, geom_label
from dappo_batch.results import Edit
from dappo_batch.robots import Robot
from dappo_batch.robots.contact_masks import is_static, masks_match, touches_itself
from dappo_batch.robots.faults import raise_faults

__all__ = ["INTEGRATORS", "simplify"]

INTEGRATORS = {
    "rk4": mujoco.mjtIntegrator.mjINT_RK4,
    "euler": mujoco.mjtIntegrator.mjINT_EULER,
    "implicitfast": mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
}
_CONES = {"pyramidal": mujoco.mjtCone.mjCONE_PYRAMIDAL, "elliptic": mujoco.mjtCone.mjCONE_ELLIPTIC}
_TABLE = "[simplify]"
_MOST_MASKS = 31
"""Bits of a contact mask, a signed integer."""


def simplify(spec: mujoco.MjSpec, robot: Robot) -> tuple[Edit, ...]:
    """Apply ``[simplify]`` and then ``[[override]]`` of a robot TOML to its MJCF.

    Parameters
    ----------
    spec : mujoco.MjSpec
        The robot, edited in place.
    robot : Robot
        Its TOML.

    Returns
    -------
    tuple of Edit
        What was changed; entries that change nothing are left out.

    Raises
    ------
    ConfigError
        If a name does not exist, an expression matches nothing, or a value cannot be applied, with all
        faults.
    """
    log = EditLog()
    section: Mapping[str, Any] = robot.spec.get("simplify", {})
    _set_options(spec, section, log)
    if "floor_contacts" in section or section.get("self_collision") is False:
        _limit_contacts(spec, robot, section.get("floor_contacts"), log)
    if "condim" in section:
        _set_condim(spec, int(section["condim"]), log)
    apply_overrides(spec, robot.spec.get("override", []), log)
    raise_faults(f"robot {robot.name}", log.faults)
    return log.edits


def _set_options(spec: mujoco.MjSpec, section: Mapping[str, Any], log: EditLog) -> None:
    option = spec.option
    for key, values, kind in (
        ("integrator", INTEGRATORS, mujoco.mjtIntegrator),
        ("cone", _CONES, mujoco.mjtCone),
    ):
        if key in section:
            before = kind(getattr(option, key)).name.partition("_")[2].lower()
            log.record(_TABLE, key, "", before, section[key])
            setattr(option, key, values[section[key]])
    for key in ("timestep", "impratio"):
        if key in section:
            log.record(_TABLE, key, "", getattr(option, key), section[key])
            setattr(option, key, float(section[key]))


def _set_condim(spec: mujoco.MjSpec, condim: int, log: EditLog) -> None:
    """Set the dimension of all contacts: MuJoCo takes the larger one of the two geoms."""
    for geom in filter(can_collide, spec.geoms):
        log.record(_TABLE, "condim", geom_label(geom), geom.condim, condim)
        geom.condim = condim
    for pair in spec.pairs:
        log.record(_TABLE, "condim", f"pair {pair.geomname1} {pair.geomname2}", pair.condim, condim)
        pair.condim = condim


def _limit_contacts(
    spec: mujoco.MjSpec, robot: Robot, floor_contacts: Sequence[str] | None, log: EditLog
) -> None:
    """Remove the contacts within the robot, and all contacts of geoms that are not listed."""
    main = spec.body(robot.main_body)
    if main is None or is_static(main):
        return  # reported with the other requirements of the compiled robot
    root = _root(main)
    of_robot = [geom for geom in spec.geoms if not is_static(geom.parent) and _root(geom.parent) == root]
    names = {geom.name for geom in of_robot if geom.name}
    ends = [(pair, {pair.geomname1, pair.geomname2}) for pair in spec.pairs]
    in_pairs = {name for _, both in ends for name in both}
    touching = [geom for geom in of_robot if can_collide(geom) or geom.name in in_pairs]
    kept = touching
    if floor_contacts is not None:
        outer = {name for _, both in ends if not both <= names for name in both}
        kept = _Listed(spec, touching, outer, log).geoms(floor_contacts)
    remaining = set(kept)
    lost = [geom for geom in touching if geom not in remaining]
    collides = touches_itself(touching) or any(both <= names for _, both in ends)
    if log.faults or not (lost or collides):
        return
    if collides:
        log.record(_TABLE, "self_collision", "", "true", "false")
    if lost:
        before, after = (listed(map(geom_label, geoms)) for geoms in (touching, kept))
        log.record(_TABLE, "floor_contacts", "", before, after)
    lost_names = {geom.name for geom in lost if geom.name}
    for pair, both in ends:
        if both <= names or both & lost_names:
            spec.delete(pair)
    for geom in lost:
        geom.contype = geom.conaffinity = 0
    _separate(spec, of_robot, log)


def _root(body: mujoco.MjsBody) -> mujoco.MjsBody:
    """Return the first body of the kinematic tree of a body that moves."""
    while not is_static(body.parent):
        body = body.parent
    return body


class _Listed:
    """Finds the geoms of ``floor_contacts``."""

    def __init__(
        self, spec: mujoco.MjSpec, touching: list[mujoco.MjsGeom], outer: set[str], log: EditLog
    ) -> None:
        self.spec, self.touching, self.log = spec, touching, log
        self._in_outer_pairs = outer
        self._static = [geom for geom in spec.geoms if is_static(geom.parent)]

    def geoms(self, names: Iterable[str]) -> list[mujoco.MjsGeom]:
        """Return the geoms of some names, in the order of the MJCF."""
        found = {geom for name in names for geom in self._find(name)}
        return [geom for geom in self.touching if geom in found]

    def _find(self, name: str) -> list[mujoco.MjsGeom]:
        geom, body = self.spec.geom(name), self.spec.body(name)
        geoms = [geom] if geom is not None else [other for other in self.touching if other.parent == body]
        if geom is None and body is None:
            self._fault(f"there is no geom or body {name!r}; {self._proposal(name)}")
        elif not geoms:
            self._fault(f"body {name!r} has no geom that can touch anything; {self._proposal(name)}")
        elif not any(map(self._can_touch_the_world, geoms)):
            what = "geom" if geom is not None else "body"
            self._fault(f"{what} {name!r} is not part of the robot, or can touch nothing of the world")
        else:
            return geoms
        return []

    def _can_touch_the_world(self, geom: mujoco.MjsGeom) -> bool:
        if geom not in self.touching:
            return False
        return geom.name in self._in_outer_pairs or any(masks_match(geom, other) for other in self._static)

    def _proposal(self, name: str) -> str:
        known = [geom.name or geom.parent.name for geom in self.touching if geom.name or geom.parent.name]
        near = get_close_matches(name, known, n=3)
        return f"did you mean {listed(near)}?" if near else f"the robot has {listed(known) or 'none'}"

    def _fault(self, what: str) -> None:
        self.log.faults.append(f"{_TABLE} floor_contacts: {what}")


def _separate(spec: mujoco.MjSpec, of_robot: Sequence[mujoco.MjsGeom], log: EditLog) -> None:
    """Set the masks so that two geoms of the robot do not match, and all others as before.

    Moving geoms with equal masks get a bit as ``conaffinity``; ``contype`` has the bits of those that match.
    Static geoms need no ``conaffinity``: MuJoCo never lets them touch each other.
    """
    robot = set(of_robot)
    moving = [
        (geom, geom in robot) for geom in spec.geoms if not is_static(geom.parent) and can_collide(geom)
    ]
    kinds: dict[tuple[bool, int, int], int] = {}
    for geom, is_robot in moving:
        kinds.setdefault((is_robot, geom.contype, geom.conaffinity), len(kinds))
    if len(kinds) > _MOST_MASKS:
        log.faults.append(
            f"{_TABLE}: the moving geoms have {len(kinds)} different pairs of contype and conaffinity; the"
            f" limit is {_MOST_MASKS} to remove self-collision"
        )
        return

    def bits(contype: int, conaffinity: int, *, is_robot: bool) -> int:
        return sum(
            1 << bit
            for (other_is_robot, other_contype, other_conaffinity), bit in kinds.items()
            if not (is_robot and other_is_robot)
            and (contype & other_conaffinity or other_contype & conaffinity)
        )

    masks = []
    for geom, is_robot in moving:
        bit = kinds[is_robot, geom.contype, geom.conaffinity]
        masks.append((geom, bits(geom.contype, geom.conaffinity, is_robot=is_robot), 1 << bit))
    static = (geom for geom in spec.geoms if is_static(geom.parent))
    masks += [(geom, bits(geom.contype, geom.conaffinity, is_robot=False), 0) for geom in static]
    for geom, contype, conaffinity in masks:
        geom.contype, geom.conaffinity = contype, conaffinity
