"""Terms of a task that are Python functions over all envs, for research."""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from dappo_batch._core import ConfigError

__all__ = ["PythonTerms", "Term", "TermBatch", "import_function", "import_module", "returned"]


@dataclass(frozen=True)
class TermBatch:
    """N envs after a step or a reset, as a term of a task gets them.

    Attributes
    ----------
    dt : float
        Duration of an env step, s.
    qpos : float64[N, nq]
        Generalised positions, m and rad, in MuJoCo's order.
    qvel : float64[N, nv]
        Generalised velocities, m/s and rad/s.
    actions : float32[N, A]
        The actions of the step, as the policy chose them; 0 after a reset.
    command : float64[N, C]
        Commands of the next step (m/s, m/s, rad/s); C is 0 for a task without commands.
    damage_class : int64[N]
        Active damage classes.
    """

    dt: float
    qpos: NDArray[np.float64]
    qvel: NDArray[np.float64]
    actions: NDArray[np.float32]
    command: NDArray[np.float64]
    damage_class: NDArray[np.int64]


Term: TypeAlias = Callable[[TermBatch], NDArray[Any]]
"""A term: [N, size] numbers of an observation, [N] of a reward, or [N] booleans of a termination."""


def import_module(name: str) -> Any:  # noqa: ANN401 - a module has any attributes
    """Import a module of a user, from the current folder as well, as ``python -m`` does.

    Raises
    ------
    ConfigError
        If it cannot be imported.
    """
    folder = os.getcwd()
    if added := folder not in sys.path:
        sys.path.insert(0, folder)
    try:
        return importlib.import_module(name)
    except Exception as error:
        raise ConfigError(
            f"cannot import the module {name!r}: {type(error).__name__}: {error}; modules are looked for in"
            " the current folder and on PYTHONPATH"
        ) from error
    finally:
        if added and folder in sys.path:
            sys.path.remove(folder)


def import_function(name: str, what: str) -> Any:  # noqa: ANN401 - a function has any signature
    """Import a function of a user, ``"module:function"``, that `what` needs.

    Raises
    ------
    ConfigError
        If there is none.
    """
    module, _, attribute = name.partition(":")
    if not module or not attribute:
        raise ConfigError(f'{what} needs a function as "module:function", got {name!r}')
    found = getattr(import_module(module), attribute, None)
    if not callable(found):
        raise ConfigError(f"the module {module!r} has no function {attribute!r}, which {what} needs")
    return found


class PythonTerms:
    """The functions that a task names, as ``"module:function"``.

    Parameters
    ----------
    observations : sequence of (str, int)
        Names and sizes of the terms of observations.
    rewards, terminations : sequence of str
        Names of the terms of the reward and of the terminations.
    dt : float
        Duration of an env step, s.

    Raises
    ------
    ConfigError
        If a function does not exist.
    """

    def __init__(
        self,
        observations: Sequence[tuple[str, int]],
        rewards: Sequence[str],
        terminations: Sequence[str],
        dt: float,
    ) -> None:
        self._observations = [
            (name, size, import_function(name, "a term of the task")) for name, size in observations
        ]
        self._rewards = [(name, import_function(name, "a term of the task")) for name in rewards]
        self._terminations = [(name, import_function(name, "a term of the task")) for name in terminations]
        self._dt = dt

    def observe(self, *arrays: NDArray[Any]) -> list[NDArray[np.float32]]:
        """Return the terms of the observation, [N, size] each; `arrays` are those of `TermBatch`."""
        batch = TermBatch(self._dt, *arrays)
        return [
            returned(f"the term {name}", term(batch), (len(batch.qpos), size), np.float32)
            for name, size, term in self._observations
        ]

    def judge(self, *arrays: NDArray[Any]) -> tuple[list[NDArray[np.float64]], list[NDArray[np.bool_]]]:
        """Return the terms of the reward and of the terminations, [N] each."""
        batch = TermBatch(self._dt, *arrays)
        shape = (len(batch.qpos),)
        rewards = [
            returned(f"the term {name}", term(batch), shape, np.float64) for name, term in self._rewards
        ]
        failures = [
            returned(f"the term {name}", term(batch), shape, np.bool_) for name, term in self._terminations
        ]
        return rewards, failures


def returned(what: str, value: object, shape: tuple[int, ...], kind: type[Any]) -> NDArray[Any]:
    """Return what a function of a user, `what`, returned for all envs, as an array of `kind`.

    Raises
    ------
    ConfigError
        If it has another shape, or is no number or boolean, or not finite.
    """
    array = np.asarray(value)
    if (
        array.shape != shape
        or (kind is np.bool_) != (array.dtype == np.bool_)
        or array.dtype.kind not in "biuf"
    ):
        expected = "booleans" if kind is np.bool_ else "numbers"
        raise ConfigError(
            f"{what} returned shape {array.shape} of {array.dtype}, expected {expected} of shape {shape}"
        )
    array = np.ascontiguousarray(array, dtype=kind)
    if kind is not np.bool_ and not np.isfinite(array).all():
        env = int(np.argwhere(~np.isfinite(array))[0][0])
        raise ConfigError(f"{what} returned a value that is not finite for env {env}")
    return array
