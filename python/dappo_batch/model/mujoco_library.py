"""The path of libmujoco, and properties of the installed version for Rust."""

from __future__ import annotations

import threading
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import mujoco

from dappo_batch._core import SimulationError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from dappo_batch.model import ClassTable

MUJOCO_ERRORS: tuple[type[Exception], ...] = (
    mujoco.FatalError,
    mujoco.UnexpectedError,
    MemoryError,
    OverflowError,
    RuntimeError,
    TypeError,
    ValueError,
)
"""Exceptions of MuJoCo when it reads or compiles an invalid model."""


_hook = threading.Lock()
_quiet = 0
_before: Callable[[str], Any] | None = None


@contextmanager
def quiet_mujoco() -> Iterator[None]:
    """Keep MuJoCo from writing warnings to the terminal and to ``MUJOCO_LOG.TXT`` in the working directory.

    The causes of the warnings are checked separately.
    """
    global _before, _quiet
    # The hook is global: the first context sets it, the last one restores it.
    with _hook:
        if _quiet == 0:
            _before = mujoco.get_mju_user_warning()
            mujoco.set_mju_user_warning(lambda _: None)
        _quiet += 1
    try:
        yield
    finally:
        with _hook:
            _quiet -= 1
            if _quiet == 0:
                mujoco.set_mju_user_warning(_before)


# With fewer iterations a solver does not converge, and its result depends on its start. With 4 iterations of
# Newton's method the error of the Ant after an env step is 0.004 rad/s, with 6 it is rounding.
_ENOUGH_ITERATIONS = {mujoco.mjtSolver.mjSOL_NEWTON: 10}
_ENOUGH_ITERATIONS_OF_OTHERS = 100
_ENOUGH_LINE_SEARCH = 10


def hidden_state(model: mujoco.MjModel) -> str:
    """Return the parts of a model's state besides positions and velocities; empty if there are none."""
    # Versions of MuJoCo without one of the sizes do not have the feature.
    sizes = {
        "na": "activations of actuators",
        "nhistory": "numbers of delayed signals",
        "npluginstate": "numbers of plugins",
        "nplastic": "plastic parts",
    }
    counts = ((int(getattr(model, name, 0)), what) for name, what in sizes.items())
    found = [f"{count} {what}" for count, what in counts if count]
    enough = _ENOUGH_ITERATIONS.get(mujoco.mjtSolver(model.opt.solver), _ENOUGH_ITERATIONS_OF_OTHERS)
    limits = {"iterations": enough, "ls_iterations": _ENOUGH_LINE_SEARCH}
    early = [name for name, limit in limits.items() if int(getattr(model.opt, name)) < limit]
    if early:
        got = ", ".join(
            f"{name} = {getattr(model.opt, name)} instead of at least {limits[name]}" for name in early
        )
        found.append(f"the start of a solver that does not converge ({got})")
    return ", ".join(found)


def library_path() -> Path:
    """Return the shared library inside the installed ``mujoco`` package.

    Raises
    ------
    SimulationError
        If the package contains no such library.
    """
    folder = Path(mujoco.__file__).parent
    for pattern in ("libmujoco.so*", "libmujoco*.dylib", "mujoco.dll"):
        for found in sorted(folder.glob(pattern)):
            return found
    message = f"no MuJoCo library in {folder}; reinstall the `mujoco` package"
    raise SimulationError(message)


def state_spec() -> int:
    """Return the ``mjtState`` bits of the state on which the next physics step depends.

    The bits differ between MuJoCo versions, so they are read from the installed one: time, positions,
    velocities, activations, delayed signals, plugin states, and the solver's warm start.
    """
    return int(mujoco.mjtState.mjSTATE_FULLPHYSICS) | int(mujoco.mjtState.mjSTATE_WARMSTART)


def divergence_counters(data: mujoco.MjData) -> list[int]:
    """Return the addresses of the counters of diverged positions, velocities and accelerations.

    ``mj_step`` resets the data of a robot whose numbers are not finite or too large, and continues. Only
    these counters of warnings (C ``int``) show it.
    """
    warnings = mujoco.mjtWarning
    found = (warnings.mjWARN_BADQPOS, warnings.mjWARN_BADQVEL, warnings.mjWARN_BADQACC)
    return [data.warning.number[int(warning) :].ctypes.data for warning in found]


def integrator_name(table: ClassTable) -> str:
    """Return the integrator of a class table's models, for example ``rk4``."""
    name: str = mujoco.mjtIntegrator(table.models[0].opt.integrator).name
    return name.removeprefix("mjINT_").lower()
