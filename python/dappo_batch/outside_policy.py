"""Policies of other learners, as Python functions."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from dappo_batch._checks import shown
from dappo_batch._core import ConfigError
from dappo_batch.terms import import_function, returned

__all__ = ["Act", "OutsidePolicy"]

Act: TypeAlias = Callable[[NDArray[np.float32]], ArrayLike]
"""A policy: actions [N, A] for raw observations [N, O] of N robots. It is called once in each env step, and
all episodes begin with the first call; one that remembers something may have a method ``reset()``, which is
called before."""


class OutsidePolicy:
    """A policy that is a Python function.

    Parameters
    ----------
    act : callable or str
        The function, or ``"module:function"``.
    action_dim : int
        Length of an action, A.

    Raises
    ------
    ConfigError
        If there is no such function.
    """

    def __init__(self, act: Act | str, action_dim: int) -> None:
        if isinstance(act, str):
            self.name, self._act = act, import_function(act, "act")
        elif callable(act):
            name = str(getattr(act, "__qualname__", type(act).__qualname__))
            self.name, self._act = name.rpartition("<locals>.")[2], act
        else:
            raise ConfigError(f'act must be a function or "module:function", got {shown(act)}')
        self._action_dim = action_dim

    @property
    def folder(self) -> str:
        """Its name as part of the name of a folder."""
        return re.sub(r"[^A-Za-z0-9.]+", "_", self.name.replace(":", ".")).strip("_")

    def reset(self) -> None:
        """Begin new episodes."""
        reset = getattr(self._act, "reset", None)
        if callable(reset):
            reset()

    def act(self, obs: NDArray[np.float32]) -> NDArray[np.float32]:
        """Choose actions, [N, A].

        Raises
        ------
        ConfigError
            If the function returns anything else.
        """
        return returned(f"the policy {self.name}", self._act(obs), (len(obs), self._action_dim), np.float32)
