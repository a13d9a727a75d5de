"""Weak motor: the motors of the limb have lost part of their torque."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import mujoco
import numpy as np

from dappo_batch._core import ConfigError
from dappo_batch.damage.base import DamageType
from dappo_batch.damage.parts import carries, is_on, joints_of

if TYPE_CHECKING:
    from dappo_batch.robots import Limb

__all__ = ["WeakMotor"]

# Types whose force is linear in their parameters.
_SCALABLE_GAINS = (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtGain.mjGAIN_AFFINE)
_SCALABLE_BIASES = (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)


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
    """

    strength: float = 0.5

    name: ClassVar[str] = "weak_motor"

    def __post_init__(self) -> None:
        if not 0 <= self.strength < 1:
            raise ConfigError(f"weak_motor: strength must be at least 0 and below 1, got {self.strength}")

    def apply(self, spec: mujoco.MjSpec, limb: Limb, severity: float) -> None:
        """Weaken the actuators of the limb; see `DamageType.apply`."""
        actuators = [actuator for actuator in spec.actuators if _moves(spec, actuator, limb)]
        if not actuators:
            raise ConfigError(f"weak_motor: limb {limb.name} has no actuator")
        joints = joints_of(spec, limb)
        if any(joint.actgravcomp for joint in joints):
            raise ConfigError(
                f"weak_motor: limb {limb.name} has a joint whose actuators compensate for gravity"
                " (actuatorgravcomp),"
                " which does not weaken; use gravity compensation without it"
            )
        share = 1 + severity * (self.strength - 1)
        tendons = {a.target for a in actuators if a.trntype == mujoco.mjtTrn.mjTRN_TENDON}
        for actuator in actuators:
            is_plugin = actuator.plugin is not None and actuator.plugin.active
            if (
                is_plugin
                or actuator.gaintype not in _SCALABLE_GAINS
                or actuator.biastype not in _SCALABLE_BIASES
            ):
                raise ConfigError(
                    f"weak_motor: actuator {actuator.name} has a gain or a bias of another kind than fixed or"
                    " affine; make it a motor, or a position or velocity servo"
                )
            actuator.gainprm = share * np.asarray(actuator.gainprm)
            actuator.biasprm = share * np.asarray(actuator.biasprm)
            if share > 0:  # MuJoCo allows no range of width 0, and a dead motor needs none
                actuator.forcerange = share * np.asarray(actuator.forcerange)
        # With the old limit a saturated motor would have the torque of a healthy one.
        for limited in [*joints, *(spec.tendon(name) for name in tendons)]:
            if share > 0:
                limited.actfrcrange = share * np.asarray(limited.actfrcrange)


def _moves(spec: mujoco.MjSpec, actuator: mujoco.MjsActuator, limb: Limb) -> bool:
    """Return whether an actuator belongs to a limb.

    Raises
    ------
    ConfigError
        If it moves the limb together with another one.
    """
    inside, foreign = False, []
    for body in _bodies_moved(spec, actuator):
        if is_on(body, limb):
            inside = True
        elif actuator.trntype == mujoco.mjtTrn.mjTRN_TENDON and _is_fixed(spec.tendon(actuator.target)):
            foreign.append(body.name)  # a joint of the torso moves too
        elif not carries(body, spec, limb):
            foreign.append(body.name)
    if inside and foreign:
        raise ConfigError(
            f"weak_motor: actuator {actuator.name or actuator.target} moves limb {limb.name} together with"
            " body"
            f" {foreign[0]!r} outside of it; give the limb separate actuators"
        )
    return inside


def _bodies_moved(spec: mujoco.MjSpec, actuator: mujoco.MjsActuator) -> list[mujoco.MjsBody]:
    kind, transmissions = actuator.trntype, mujoco.mjtTrn
    if kind == transmissions.mjTRN_BODY:
        return _existing([spec.body(actuator.target)])
    if kind == transmissions.mjTRN_SITE:
        return [site.parent for site in _existing([spec.site(actuator.target), spec.site(actuator.refsite)])]
    if kind == transmissions.mjTRN_SLIDERCRANK:
        return [
            site.parent for site in _existing([spec.site(actuator.target), spec.site(actuator.slidersite)])
        ]
    if kind == transmissions.mjTRN_TENDON:
        tendon = spec.tendon(actuator.target)
        targets = [] if tendon is None else [wrap.target for wrap in tendon.path]
        return [target.parent for target in targets if target is not None]
    # Every other transmission has a joint.
    return [joint.parent for joint in _existing([spec.joint(actuator.target)])]


def _existing(items: list[Any]) -> list[Any]:
    """Leave out references to missing parts, which the compiler reports."""
    return [item for item in items if item is not None]


def _is_fixed(tendon: mujoco.MjsTendon) -> bool:
    return all(wrap.type == mujoco.mjtWrap.mjWRAP_JOINT for wrap in tendon.path)
