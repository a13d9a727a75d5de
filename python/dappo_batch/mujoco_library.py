"""Where libmujoco lies, and what Rust must know about the installed version."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import mujoco

from dappo_batch._core import SimulationError

if TYPE_CHECKING:
    from dappo_batch.class_table import ClassTable


def library_path() -> Path:
    """Return the shared library inside the installed ``mujoco`` package.

    Raises
    ------
    SimulationError
        If the package holds no such library.
    """
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll"):
        for found in sorted(folder.glob(pattern)):
            return found
    message = f"no MuJoCo library in {folder}; reinstall the `mujoco` package"
    raise SimulationError(message)


def state_spec() -> int:
    """Return the ``mjtState`` bits of everything that the next physics step depends on.

    The bits differ between MuJoCo versions, so they are read from the installed one: time, positions,
    velocities, activations, and the solver's warm start.
    """
    return (
        int(mujoco.mjtState.mjSTATE_PHYSICS)
        | int(mujoco.mjtState.mjSTATE_WARMSTART)
        | int(mujoco.mjtState.mjSTATE_TIME)
    )


def divergence_counters(data: mujoco.MjData) -> list[int]:
    """Return the addresses of the counters of diverged positions, velocities and accelerations.

    ``mj_step`` resets the data of a robot whose numbers are not finite or too large, and goes on as if
    nothing had happened. These counters of warnings (C ``int``) are the only trace that it leaves.
    """
    warnings = mujoco.mjtWarning
    found = (warnings.mjWARN_BADQPOS, warnings.mjWARN_BADQVEL, warnings.mjWARN_BADQACC)
    return [data.warning.number[int(warning) :].ctypes.data for warning in found]


def integrator_name(table: ClassTable) -> str:
    """Return the integrator of a class table's models, for example ``rk4``."""
    name: str = mujoco.mjtIntegrator(table.models[0].opt.integrator).name
    return name.removeprefix("mjINT_").lower()
