"""Jammed joint: one joint of the limb can hardly move."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import mujoco

from dappo_batch._core import ConfigError
from dappo_batch.damage.base import DamageType

if TYPE_CHECKING:
    from dappo_batch.robots import Limb

__all__ = ["JammedJoint"]


@dataclass(frozen=True)
class JammedJoint(DamageType):
    """A joint whose range shrinks to a small interval around its reference position.

    Both ends of the range move linearly with the severity, from the healthy range to ±`range_deg` around
    the joint's ``ref``, by default 0. Only ``jnt_range`` of the compiled model
    changes: the joint's limits are soft constraints, and a strong motor moves a jammed joint a little
    beyond them.

    Attributes
    ----------
    joint : int
        Index of the joint in the limb, from the torso outwards.
    range_deg : float
        Half the range at severity 1, in degrees.
    """

    joint: int = 0
    range_deg: float = 0.1

    name: ClassVar[str] = "jammed_joint"

    def __post_init__(self) -> None:
        if self.joint < 0:
            raise ConfigError(f"jammed_joint: joint counts from 0, got {self.joint}")
        if not (math.isfinite(self.range_deg) and self.range_deg > 0):
            raise ConfigError(f"jammed_joint: range_deg must be above 0, got {self.range_deg}")

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        """Narrow the range of the limb's joint; see `DamageType.apply`."""
        if self.joint >= len(limb.joints):
            raise ConfigError(
                f"jammed_joint: limb {limb.name} has {len(limb.joints)} joints, so joint must be below that,"
                f" got {self.joint}"
            )
        name = limb.joints[self.joint]
        joint = spec.joint(name)
        if joint is None:
            raise ConfigError(f"jammed_joint: limb {limb.name}: the MJCF has no joint {name!r}")
        if joint.type != mujoco.mjtJoint.mjJNT_HINGE:
            raise ConfigError(f"jammed_joint: joint {name} is not a hinge, which a range in degrees needs")
        if not _is_limited(joint):
            raise ConfigError(f"jammed_joint: joint {name} has no limits; give it a range")
        # MjSpec keeps angles in the unit of their file; the compiler converts them.
        target = self.range_deg if joint.compiler.degree else math.radians(self.range_deg)
        low, high = float(joint.range[0]), float(joint.range[1])
        middle = float(joint.ref)
        joint.range = [low + severity * (middle - target - low), high + severity * (middle + target - high)]


def _is_limited(joint: mujoco.MjsJoint) -> bool:
    if joint.limited == mujoco.mjtLimited.mjLIMITED_AUTO:
        return bool(joint.compiler.autolimits) and joint.range[0] < joint.range[1]
    return bool(joint.limited == mujoco.mjtLimited.mjLIMITED_TRUE)
