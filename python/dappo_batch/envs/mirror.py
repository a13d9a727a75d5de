"""Mirror images of observations and actions, for learners that use the left-right symmetry of a robot."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

__all__ = ["Mirror", "Reflection"]


@dataclass(frozen=True, eq=False)
class Reflection:
    """The reflection of vectors of length K.

    Attributes
    ----------
    index : NDArray[np.intp]
        Of each entry of the mirror image, the entry that it is of the vector, [K].
    sign : NDArray[np.float32]
        Its sign, 1 or -1, [K].
    """

    index: NDArray[np.intp]
    sign: NDArray[np.float32]

    def __call__(self, vectors: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return the mirror images of vectors, [..., K]."""
        return vectors[..., self.index] * self.sign


@dataclass(frozen=True, eq=False)
class Mirror:
    """How observations and actions of a robot are reflected at its plane of symmetry, left to right.

    If the action ``a`` leads from ``s`` to ``t``, ``mirror.actions(a)`` leads from ``mirror.obs(s)`` to
    ``mirror.obs(t)``, with the same reward.

    Attributes
    ----------
    obs : Reflection
        Of observations, the damage code included, K = O.
    actions : Reflection
        Of actions, K = A.
    """

    obs: Reflection
    actions: Reflection
