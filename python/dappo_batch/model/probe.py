"""Small simulations that determine what the installed MuJoCo computes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np
    from numpy.typing import NDArray

__all__ = ["probe_body", "stepped"]


def probe_body(
    integrator: mujoco.mjtIntegrator, timestep: float, inertia: Sequence[float] | NDArray[np.float64]
) -> tuple[mujoco.MjSpec, mujoco.MjsBody]:
    """Return a model without gravity, and its only body, of 1 kg."""
    spec = mujoco.MjSpec()
    spec.compiler.usethread = False
    spec.option.integrator = integrator
    spec.option.timestep = timestep
    spec.option.gravity = [0, 0, 0]
    return spec, spec.worldbody.add_body(mass=1, inertia=inertia, explicitinertial=True)


def stepped(spec: mujoco.MjSpec, qvel: Sequence[float] | NDArray[np.float64]) -> mujoco.MjData:
    """Return the state one step after the reference pose with a velocity, [nv]."""
    model = spec.compile()
    data = mujoco.MjData(model)
    data.qvel[:] = qvel
    mujoco.mj_step(model, data)
    return data
