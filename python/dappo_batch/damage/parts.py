"""The parts of a limb in an MJCF that is not compiled yet."""

from __future__ import annotations

import math
import re
from typing import TYPE_CHECKING

import mujoco

from dappo_batch._checks import listed, shown
from dappo_batch._core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dappo_batch.robots import Limb

__all__ = ["carries", "check_joint", "default_position", "is_on", "joints_of", "select_joint"]


def is_on(body: mujoco.MjsBody, limb: Limb) -> bool:
    """Return whether a body is the root body of a limb or lies below it."""
    while body is not None and body.name != "world":
        if body.name == limb.body:
            return True
        body = body.parent
    return False


def carries(body: mujoco.MjsBody, spec: mujoco.MjSpec, limb: Limb) -> bool:
    """Return whether a body is above a limb in the kinematic tree, as the torso is."""
    if body.name == "world":
        return True
    above = spec.body(limb.body)
    while above is not None and above.name != "world":
        if above == body:
            return True
        above = above.parent
    return False


def joints_of(spec: mujoco.MjSpec, limb: Limb) -> list[mujoco.MjsJoint]:
    """Return the joints of all bodies of a limb."""
    return [joint for joint in spec.joints if is_on(joint.parent, limb)]


def check_joint(joint: int | str, owner: str) -> None:
    """Check the parameter of a damage type that selects a joint of a limb.

    Raises
    ------
    ConfigError
        If it is a negative index, or a text that is not a regular expression.
    """
    if isinstance(joint, str):
        try:
            re.compile(joint)
        except (re.error, OverflowError, RecursionError) as error:
            raise ConfigError(
                f"{owner}: joint is not a regular expression: {error}, got {shown(joint)}"
            ) from error
    elif joint < 0:
        raise ConfigError(f"{owner}: joint counts from 0, got {joint}")


def select_joint(spec: mujoco.MjSpec, limb: Limb, joint: int | str, owner: str) -> mujoco.MjsJoint:
    """Return the joint of a limb by its index, or by a regular expression that is found in its name.

    Raises
    ------
    ConfigError
        If the limb or the MJCF has no such joint, or several match.
    """
    if isinstance(joint, str):
        found = [name for name in limb.joints if re.search(joint, name)]
        if len(found) != 1:
            what = f"matches {len(found)} joints, {listed(found)}," if found else "matches no joint"
            raise ConfigError(
                f"{owner}: limb {limb.name}: joint = {shown(joint)} {what} and must match one of"
                f" {listed(limb.joints)}"
            )
        name = found[0]
    elif joint < len(limb.joints):
        name = limb.joints[joint]
    else:
        raise ConfigError(
            f"{owner}: limb {limb.name} has {len(limb.joints)} joints, so joint must be below that,"
            f" got {joint}"
        )
    selected = spec.joint(name)
    if selected is None:
        raise ConfigError(f"{owner}: limb {limb.name}: the MJCF has no joint {name!r}")
    return selected


def default_position(spec: mujoco.MjSpec, limb: Limb, joint: mujoco.MjsJoint, owner: str) -> float:
    """Return the position of a hinge in the robot's default pose, in the unit of the MJCF.

    Raises
    ------
    ConfigError
        If the MJCF lacks the keyframe of the default pose.
    """
    if limb.keyframe is None:
        return float(joint.ref)
    key = spec.key(limb.keyframe)
    if key is None:
        known = [repr(other.name) for other in spec.keys if other.name]
        raise ConfigError(
            f"{owner}: the MJCF has no keyframe {limb.keyframe!r}, the default pose of the robot TOML;"
            f" expected one of {listed(known) or 'none'}"
        )
    if not len(key.qpos):  # a keyframe without qpos has that of the reference pose
        return float(joint.ref)
    address = 0
    for other in _in_order(spec.worldbody):
        if other == joint:
            break
        address += _POSITIONS.get(other.type, 1)
    position = float(key.qpos[address])
    return math.degrees(position) if joint.compiler.degree else position


_POSITIONS = {mujoco.mjtJoint.mjJNT_FREE: 7, mujoco.mjtJoint.mjJNT_BALL: 4}
"""Entries of qpos of joints with more than one."""


def _in_order(body: mujoco.MjsBody) -> Iterator[mujoco.MjsJoint]:
    """Return all joints of a body and those below it in the order of qpos."""
    yield from body.joints
    for child in body.bodies:
        yield from _in_order(child)
