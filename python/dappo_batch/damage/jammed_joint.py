"""Jammed joint: one joint of the limb can hardly move."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import mujoco

from dappo_batch._core import ConfigError
from dappo_batch.damage.base import DamageType
from dappo_batch.damage.parts import check_joint, default_position, select_joint

if TYPE_CHECKING:
    from dappo_batch.robots import Limb

__all__ = ["JammedJoint"]

_PLACES = ("zero", "default")
_UNLIMITED = 180.0
"""Half the healthy range of a hinge without limits, degrees."""
_ROUNDING = 1e-9


@dataclass(frozen=True)
class JammedJoint(DamageType):
    """A joint whose range shrinks to a small interval around the position at which it jams.

    Both ends of the range move linearly with the severity, from the healthy range to ±`range_deg` around
    that position. Only ``jnt_range`` of the compiled model changes: the joint's limits are soft constraints,
    and a strong motor moves a jammed joint a little beyond them. A hinge without limits receives some
    (``jnt_limited`` changes too); its healthy range counts as ±180° around the position.

    Attributes
    ----------
    joint : int or str
        The joint of the limb: its index from the torso outwards, or a regular expression (of Python's `re`)
        that is found in the name of exactly one joint of every limb.
    range_deg : float
        Half the range at severity 1, in degrees.
    at : {"zero", "default"} or float
        Where the joint jams: ``"zero"`` is its position in the reference pose of the MJCF, its ``ref``;
        ``"default"`` is that in the robot's default pose, the keyframe ``[reset] keyframe`` of the robot
        TOML, or the reference pose without one; a number is an angle in degrees. It must lie within the
        joint's range.
    """

    joint: int | str = 0
    range_deg: float = 0.1
    at: str | float = "zero"

    name: ClassVar[str] = "jammed_joint"

    def __post_init__(self) -> None:
        check_joint(self.joint, self.name)
        if not (math.isfinite(self.range_deg) and self.range_deg > 0):
            raise ConfigError(f"jammed_joint: range_deg must be above 0, got {self.range_deg}")
        is_place = self.at in _PLACES if isinstance(self.at, str) else math.isfinite(self.at)
        if not is_place:
            raise ConfigError(
                f'jammed_joint: at must be "zero", "default" or an angle in degrees, got {self.at!r}'
            )

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        """Narrow the range of the limb's joint; see `DamageType.apply`."""
        joint = select_joint(spec, limb, self.joint, self.name)
        if joint.type != mujoco.mjtJoint.mjJNT_HINGE:
            raise ConfigError(
                f"jammed_joint: joint {joint.name} is not a hinge, which a range in degrees needs"
            )
        # MjSpec keeps angles in the unit of their file; the compiler converts them.
        degree = 1.0 if joint.compiler.degree else math.radians(1.0)
        target = self.range_deg if joint.compiler.degree else math.radians(self.range_deg)
        middle = self._position(spec, limb, joint)
        if _is_limited(joint):
            low, high = float(joint.range[0]), float(joint.range[1])
            if not low - _ROUNDING <= middle <= high + _ROUNDING:
                raise ConfigError(
                    self._outside(limb, joint.name, middle / degree, low / degree, high / degree)
                )
        else:
            low, high = middle - _UNLIMITED * degree, middle + _UNLIMITED * degree
            joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.range = [low + severity * (middle - target - low), high + severity * (middle + target - high)]

    def _position(self, spec: mujoco.MjSpec, limb: Limb, joint: mujoco.MjsJoint) -> float:
        """Return where the joint jams, in the unit of the MJCF."""
        if self.at == "zero":
            return float(joint.ref)
        if self.at == "default":
            return default_position(spec, limb, joint, self.name)
        return float(self.at) if joint.compiler.degree else math.radians(float(self.at))

    def _outside(self, limb: Limb, joint: str, middle: float, low: float, high: float) -> str:
        place = f'at = "{self.at}"' if isinstance(self.at, str) else f"at = {self.at:g}"
        remedies = ["an angle within the range"]
        if self.at == "zero":
            remedies.insert(0, 'at = "default", its position in the robot\'s default pose')
        elif self.at == "default" and limb.keyframe is None:
            remedies.insert(0, "[reset] keyframe of the robot TOML, the keyframe of its default pose")
        return (
            f"jammed_joint: limb {limb.name}: joint {joint} would jam at {middle:.6g}° ({place}), outside of"
            f" its range of {low:.6g}° to {high:.6g}°; use {' or '.join(remedies)}"
        )


def _is_limited(joint: mujoco.MjsJoint) -> bool:
    if joint.limited == mujoco.mjtLimited.mjLIMITED_AUTO:
        return bool(joint.compiler.autolimits) and joint.range[0] < joint.range[1]
    return bool(joint.limited == mujoco.mjtLimited.mjLIMITED_TRUE)
