"""Actuators of a limb, and their forces."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from dappo_batch._core import ConfigError
from dappo_batch.damage.parts import carries, is_on, joints_of, select_joint

if TYPE_CHECKING:
    from dappo_batch.robots import Limb

__all__ = ["moves", "scale_forces"]

_JOINT_TRANSMISSIONS = (mujoco.mjtTrn.mjTRN_JOINT, mujoco.mjtTrn.mjTRN_JOINTINPARENT)
# Types whose force is linear in their parameters.
_SCALABLE_GAINS = (mujoco.mjtGain.mjGAIN_FIXED, mujoco.mjtGain.mjGAIN_AFFINE)
_SCALABLE_BIASES = (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)


def scale_forces(
    spec: mujoco.MjSpec, limb: Limb, share: float, owner: str, joint: int | str | None = None
) -> None:
    """Scale the forces of the actuators that move a limb, in every state.

    The gain, the bias and the force limit of the actuators are scaled, and the limits of the actuator force
    on their joints and tendons.

    Parameters
    ----------
    spec : mujoco.MjSpec
        The robot, edited in place.
    limb : Limb
        The limb.
    share : float
        Factor, in [0, 1].
    owner : str
        Name of the damage type, for messages.
    joint : int or str, optional
        One joint of the limb (see `select_joint`), for its actuators alone.

    Raises
    ------
    ConfigError
        If the limb or the joint has no actuator of its own, or an actuator's force cannot be scaled.
    """
    if joint is None:
        joints = joints_of(spec, limb)
        what = f"limb {limb.name}"
        actuators = [actuator for actuator in spec.actuators if moves(spec, actuator, limb, owner)]
    else:
        joints = [select_joint(spec, limb, joint, owner)]
        what = f"limb {limb.name}: joint {joints[0].name}"
        actuators = [
            actuator for actuator in spec.actuators if _moves_alone(spec, actuator, joints[0], owner)
        ]
    if not actuators:
        raise ConfigError(f"{owner}: {what} has no actuator")
    if any(item.actgravcomp for item in joints):
        raise ConfigError(
            f"{owner}: limb {limb.name} has a joint whose actuators compensate for gravity"
            " (actuatorgravcomp), which does not weaken; use gravity compensation without it"
        )
    for actuator in actuators:
        _scale(actuator, share, owner)
    if share > 0:  # MuJoCo allows no range of width 0, and a dead motor needs none
        tendons = {a.target for a in actuators if a.trntype == mujoco.mjtTrn.mjTRN_TENDON}
        # With the old limit a saturated motor would have the torque of a healthy one.
        for limited in [*joints, *(spec.tendon(name) for name in tendons)]:
            limited.actfrcrange = share * np.asarray(limited.actfrcrange)


def _scale(actuator: mujoco.MjsActuator, share: float, owner: str) -> None:
    """Scale the force of an actuator."""
    is_plugin = actuator.plugin is not None and actuator.plugin.active
    if is_plugin or actuator.gaintype not in _SCALABLE_GAINS or actuator.biastype not in _SCALABLE_BIASES:
        raise ConfigError(
            f"{owner}: actuator {actuator.name} has a gain or a bias of another kind than fixed or"
            " affine; make it a motor, or a position or velocity servo"
        )
    gain, bias = np.asarray(actuator.gainprm), np.asarray(actuator.biasprm)
    has_ratio = actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED and gain[0] == -bias[1]
    damping_ratio = bias[2] if has_ratio else 0.0
    actuator.gainprm = share * gain
    actuator.biasprm = share * bias
    if damping_ratio > 0:
        # A damping ratio instead of a damping, which the compiler makes proportional to the root of the gain.
        actuator.biasprm[2] = np.sqrt(share) * damping_ratio
    if share > 0:
        actuator.forcerange = share * np.asarray(actuator.forcerange)


def _moves_alone(
    spec: mujoco.MjSpec, actuator: mujoco.MjsActuator, joint: mujoco.MjsJoint, owner: str
) -> bool:
    """Return whether an actuator moves one joint; its transmission is the joint, or a tendon of it alone.

    Raises
    ------
    ConfigError
        If a tendon connects the actuator with other joints too.
    """
    if actuator.trntype in _JOINT_TRANSMISSIONS:
        return bool(actuator.target == joint.name)
    tendon = spec.tendon(actuator.target) if actuator.trntype == mujoco.mjtTrn.mjTRN_TENDON else None
    if tendon is None or not _is_fixed(tendon):
        return False
    names = {wrap.target.name for wrap in tendon.path if wrap.target is not None}
    if joint.name in names and len(names) > 1:
        raise ConfigError(
            f"{owner}: actuator {actuator.name or actuator.target} moves joint {joint.name} together with"
            f" {min(names - {joint.name})}; leave out the parameter joint, for all actuators of the limb"
        )
    return names == {joint.name}


def moves(spec: mujoco.MjSpec, actuator: mujoco.MjsActuator, limb: Limb, owner: str) -> bool:
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
            f"{owner}: actuator {actuator.name or actuator.target} moves limb {limb.name} together with"
            f" body {foreign[0]!r} outside of it; give the limb separate actuators"
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
