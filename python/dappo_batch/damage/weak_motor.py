"""Weak motor: motors of the limb have lost part of their torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from dappo_batch._core import ConfigError
from dappo_batch.damage.actuators import scale_forces
from dappo_batch.damage.base import DamageType
from dappo_batch.damage.parts import check_joint

if TYPE_CHECKING:
    import mujoco

    from dappo_batch.robots import Limb

__all__ = ["WeakMotor"]


@dataclass(frozen=True)
class WeakMotor(DamageType):
    """Motors or servos of the limb with a fraction of their torque, in every state.

    The fraction decreases linearly with the severity, from 1 to `strength`. It scales the gain, the bias and
    the force limit of every actuator that moves the limb by a joint, a tendon, a site, a slider-crank or a
    body, and the limits of the actuator force on the limb's joints and on those tendons.

    Attributes
    ----------
    strength : float
        Fraction of the torque at severity 1, at least 0 (dead motors) and below 1.
    joint : int, str or None
        For the motor of one joint alone, the joint as in `JammedJoint`; by default all motors of the limb.
    """

    strength: float = 0.5
    joint: int | str | None = None

    name: ClassVar[str] = "weak_motor"

    def __post_init__(self) -> None:
        if not 0 <= self.strength < 1:
            raise ConfigError(f"weak_motor: strength must be at least 0 and below 1, got {self.strength}")
        if self.joint is not None:
            check_joint(self.joint, self.name)

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        """Weaken the actuators of the limb; see `DamageType.apply`."""
        scale_forces(spec, limb, 1 + severity * (self.strength - 1), self.name, self.joint)
