"""The parts of a limb in an MJCF that is not compiled yet."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import mujoco

    from dappo_batch.robots import Limb

__all__ = ["carries", "is_on", "joints_of"]


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
