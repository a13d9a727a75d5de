"""The integration of rotations in RK4 of the installed MuJoCo.

Angular velocities at different orientations cannot simply be added. MuJoCo 4.0 corrects those of RK4's stages
(Runge-Kutta-Munthe-Kaas), older versions do not. The lane engine must match the installed version, which a
test with a spinning body determines.
"""

from __future__ import annotations

from functools import lru_cache

import mujoco
import numpy as np
from numpy.typing import NDArray

from dappo_batch.model.probe import probe_body, stepped

__all__ = ["rotation_correction"]

_INERTIA = np.array([1.0, 2.0, 2.5])  # kg m²; unequal, so that the axis of rotation moves
_SPIN = np.array([2.0, 1.0, 3.0])  # rad/s
_TIMESTEP = 0.1  # s
_TOLERANCE = 1e-10  # the two rules differ by 6e-4

Vector = NDArray[np.float64]


@lru_cache(maxsize=1)
def rotation_correction() -> bool | None:
    """Return whether MuJoCo corrects the stages of RK4 for the curvature of rotations.

    Returns
    -------
    bool or None
        None if the result agrees with neither rule.
    """
    found = _step_of_mujoco()
    for corrected in (True, False):
        if np.abs(found - _step(corrected)).max() < _TOLERANCE:
            return corrected
    return None


def _step_of_mujoco() -> Vector:
    """Return the orientation (w, x, y, z) of a spinning body after one step of RK4."""
    spec, body = probe_body(mujoco.mjtIntegrator.mjINT_RK4, _TIMESTEP, _INERTIA)
    body.add_freejoint()
    quat: Vector = stepped(spec, [0, 0, 0, *_SPIN]).qpos[3:7].copy()
    return quat


def _step(corrected: bool) -> Vector:
    """Return the same from Euler's equations, with or without the correction."""
    spin, rate, total = _SPIN, _SPIN, _SPIN / 6
    for share, weight in ((0.5, 1 / 3), (0.5, 1 / 3), (1.0, 1 / 6)):
        turned = share * _TIMESTEP * rate
        spin = _SPIN + share * _TIMESTEP * -np.cross(spin, _INERTIA * spin) / _INERTIA
        rate = _rotation_vector_rate(turned, spin) if corrected else spin
        total = total + weight * rate
    angle = _TIMESTEP * np.linalg.norm(total)
    axis = total / np.linalg.norm(total)
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * axis])


def _rotation_vector_rate(turned: Vector, spin: Vector) -> Vector:
    """Return the rate of a rotation vector whose frame turns with `spin` about its own axes (Bortz, 1971)."""
    angle = np.linalg.norm(turned)
    factor = (1 - angle / 2 / np.tan(angle / 2)) / angle**2
    turn = np.cross(turned, spin)
    rate: Vector = spin + 0.5 * turn + factor * np.cross(turned, turn)
    return rate
