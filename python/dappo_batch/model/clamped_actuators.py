"""What implicitfast of the installed MuJoCo does with actuators that are clamped at their joint.

Implicitfast treats the velocity derivatives of actuator forces implicitly. While ``actuatorfrcrange``
clamps the torque of an actuator, it does not depend on velocity: MuJoCo 4.0 then drops the derivative, older
versions keep it. The lane engine must match the installed version, which a test with one hinge determines.
"""

from __future__ import annotations

from functools import lru_cache

import mujoco

from dappo_batch.model.probe import probe_body, stepped

__all__ = ["clamped_without_derivative"]

_TIMESTEP = 0.1  # s
_DAMPING = 10.0  # N·m·s, of the actuator: its torque is -10 times the velocity
_LIMIT = 1.0  # N·m
_SPEED = 2.0  # rad/s: the torque would be -20 N·m
_INERTIA = 1.0  # kg·m²


@lru_cache(maxsize=1)
def clamped_without_derivative() -> bool:
    """Return whether MuJoCo drops the velocity derivative of an actuator that its joint clamps.

    Without the derivative, the speed changes by the torque times timestep / inertia in a step, with it by
    timestep / (inertia + timestep * damping), half of that.
    """
    without = _LIMIT * _TIMESTEP / _INERTIA
    kept = _LIMIT * _TIMESTEP / (_INERTIA + _TIMESTEP * _DAMPING)
    return _loss_of_speed() > (without + kept) / 2


def _loss_of_speed() -> float:
    """Return by how much a clamped actuator slows a hinge in one step of MuJoCo, rad/s."""
    spec, body = probe_body(mujoco.mjtIntegrator.mjINT_IMPLICITFAST, _TIMESTEP, [_INERTIA] * 3)
    body.add_joint(
        name="hinge",
        type=mujoco.mjtJoint.mjJNT_HINGE,
        axis=[0, 0, 1],
        actfrclimited=mujoco.mjtLimited.mjLIMITED_TRUE,
        actfrcrange=[-_LIMIT, _LIMIT],
    )
    actuator = spec.add_actuator(
        trntype=mujoco.mjtTrn.mjTRN_JOINT, target="hinge", biastype=mujoco.mjtBias.mjBIAS_AFFINE
    )
    actuator.biasprm[2] = -_DAMPING
    return _SPEED - float(stepped(spec, [_SPEED]).qvel[0])
