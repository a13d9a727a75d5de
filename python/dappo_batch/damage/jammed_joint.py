"""Jammed joint: one joint of the limb can hardly move."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import mujoco

from dappo_batch._core import ConfigError
from dappo_batch.damage.base import DamageType, MovingLimits
from dappo_batch.damage.parts import check_joint, default_position, select_joint

if TYPE_CHECKING:
    from dappo_batch.robots import Limb

__all__ = ["JammedJoint"]

_PLACES = ("zero", "default", "middle", "current")
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
    at : {"zero", "default", "middle", "current"} or float
        Where the joint jams: ``"zero"`` is its position in the reference pose of the MJCF, its ``ref``;
        ``"default"`` is that in the robot's default pose, the keyframe ``[reset] keyframe`` of the robot
        TOML, or the reference pose without one; ``"middle"`` is the middle of its range; ``"current"`` is
        where it is when the damage becomes active, within its range; a number is an angle in degrees. It must
        lie within the joint's range.
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
                'jammed_joint: at must be "zero", "default", "middle", "current" or an angle in degrees, got'
                f" {self.at!r}"
            )

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        """Narrow the range of the limb's joint; see `DamageType.apply`."""
        joint, (low, high) = self._joint(spec, limb)
        # MjSpec keeps angles in the unit of their file; the compiler converts them.
        degree = 1.0 if joint.compiler.degree else math.radians(1.0)
        target = self.range_deg if joint.compiler.degree else math.radians(self.range_deg)
        middle = self._position(spec, limb, joint, (low, high))
        if math.isfinite(low):
            if not low - _ROUNDING <= middle <= high + _ROUNDING:
                raise ConfigError(
                    self._outside(limb, joint.name, middle / degree, low / degree, high / degree)
                )
        else:
            low, high = middle - _UNLIMITED * degree, middle + _UNLIMITED * degree
            joint.limited = mujoco.mjtLimited.mjLIMITED_TRUE
        joint.range = [low + severity * (middle - target - low), high + severity * (middle + target - high)]

    def moving_limits(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> MovingLimits | None:
        """Return the limits that follow the joint with ``at = "current"``; see `DamageType.moving_limits`."""
        if self.at != "current":
            return None
        joint, limits = self._joint(spec, limb)
        unit = math.radians(1.0) if joint.compiler.degree else 1.0
        low, high = (bound * unit for bound in limits)
        compiled_at = self._position(spec, limb, joint, limits) * unit
        # The healthy range of a joint without limits moves with the joint.
        share = severity if math.isfinite(low) else 1.0
        return MovingLimits(joint.name, compiled_at, (low, high), share)

    def _joint(self, spec: mujoco.MjSpec, limb: Limb) -> tuple[mujoco.MjsJoint, tuple[float, float]]:
        """Return the joint and its range in the unit of the MJCF, infinite if it has no limits."""
        joint = select_joint(spec, limb, self.joint, self.name)
        if joint.type != mujoco.mjtJoint.mjJNT_HINGE:
            raise ConfigError(
                f"jammed_joint: joint {joint.name} is not a hinge, which a range in degrees needs"
            )
        if not _is_limited(joint):
            return joint, (-math.inf, math.inf)
        return joint, (float(joint.range[0]), float(joint.range[1]))

    def _position(
        self, spec: mujoco.MjSpec, limb: Limb, joint: mujoco.MjsJoint, limits: tuple[float, float]
    ) -> float:
        """Return where the joint jams, in the unit of the MJCF; for "current" any place in its range."""
        low, high = limits
        if self.at == "middle" and math.isinf(low):
            raise ConfigError(
                f'jammed_joint: limb {limb.name}: joint {joint.name} has no limits, so at = "middle" has no'
                " meaning"
            )
        if self.at == "zero" or (self.at == "current" and math.isinf(low)):
            return float(joint.ref)
        if self.at in ("middle", "current"):
            return (low + high) / 2
        if self.at == "default":
            return default_position(spec, limb, joint, self.name)
        return float(self.at) if joint.compiler.degree else math.radians(float(self.at))

    def _outside(self, limb: Limb, joint: str, middle: float, low: float, high: float) -> str:
        place = f'at = "{self.at}"' if isinstance(self.at, str) else f"at = {self.at:g}"
        remedies = ["an angle within the range"]
        if self.at == "zero":
            remedies[:0] = ['at = "default", its position in the robot\'s default pose', 'at = "middle"']
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
