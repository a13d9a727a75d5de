"""Dead motor: motors of the limb have no torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

from dappo_batch.damage.actuators import scale_forces
from dappo_batch.damage.base import DamageType
from dappo_batch.damage.parts import check_joint

if TYPE_CHECKING:
    import mujoco

    from dappo_batch.robots import Limb

__all__ = ["DeadMotor"]


@dataclass(frozen=True)
class DeadMotor(DamageType):
    """Motors or servos of the limb without torque: their joints swing freely, with their passive forces.

    It is a `WeakMotor` of strength 0, as a type of its own so that a robot can have both. Damping, friction
    loss, springs and armature of the joints remain.

    Attributes
    ----------
    joint : int, str or None
        For the motor of one joint alone, the joint as in `JammedJoint`; by default all motors of the limb.
    """

    joint: int | str | None = None

    name: ClassVar[str] = "dead_motor"

    def __post_init__(self) -> None:
        if self.joint is not None:
            check_joint(self.joint, self.name)

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        """Take the torque from the actuators of the limb; see `DamageType.apply`."""
        scale_forces(spec, limb, 1 - severity, self.name, self.joint)
