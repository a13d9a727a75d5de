"""Weak motor: the motors of the limb have lost part of their torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import mujoco
import numpy as np

from dappo_batch._core import ConfigError
from dappo_batch.damage.base import DamageType

if TYPE_CHECKING:
    from dappo_batch.robots import Limb

__all__ = ["WeakMotor"]

# The force is linear in the parameters of these.
_SCALABLE_GAINS = (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtGain.mjGAIN_AFFINE)
_SCALABLE_BIASES = (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)


@dataclass(frozen=True)
class WeakMotor(DamageType):
    """Motors or servos on the limb's joints that give a share of the torque they gave, in every state.

    The share falls linearly with the severity, from 1 to `strength`. It scales the gain, the bias and the
    limit of the force of every actuator on a joint of the limb, and nothing else.

    Attributes
    ----------
    strength : float
        Share of the torque that is left at severity 1, from 0 (dead motors) to below 1.
    """

    strength: float = 0.5

    name: ClassVar[str] = "weak_motor"

    def __post_init__(self) -> None:
        if not 0 <= self.strength < 1:
            raise ConfigError(f"weak_motor: strength must be at least 0 and below 1, got {self.strength}")

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        """Weaken the actuators of the limb; see `DamageType.apply`."""
        actuators = [
            actuator
            for actuator in spec.actuators
            if actuator.trntype == mujoco.mjtTrn.mjTRN_JOINT and actuator.target in limb.joints
        ]
        if not actuators:
            raise ConfigError(f"weak_motor: limb {limb.name} has no actuator on its joints that could weaken")
        share = 1 + severity * (self.strength - 1)
        for actuator in actuators:
            if actuator.gaintype not in _SCALABLE_GAINS or actuator.biastype not in _SCALABLE_BIASES:
                raise ConfigError(
                    f"weak_motor: actuator {actuator.name} has a gain or a bias of another kind than fixed or"
                    " affine; make it a motor, or a position or velocity servo"
                )
            actuator.gainprm = share * np.asarray(actuator.gainprm)
            actuator.biasprm = share * np.asarray(actuator.biasprm)
            actuator.forcerange = share * np.asarray(actuator.forcerange)
