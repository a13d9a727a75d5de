"""Overflow flags of `mujoco_warp` as errors, with the buffer size to raise."""

from __future__ import annotations

from typing import NamedTuple

import mujoco_warp as mjw
import numpy as np
from numpy.typing import NDArray

__all__ = ["PhysicsOverflowError", "check_overflow"]

Flag = mjw.OverflowType

# A solver that reaches its iteration limit keeps its current solution, as in MuJoCo, and many robots set a
# low limit. The last two flags concern sensors that no observation and no reward term reads.
HARMLESS = Flag.ITERATIONS | Flag.LS_ITERATIONS | Flag.CONTACT_MATCH | Flag.TACTILE


class Limit(NamedTuple):
    """A limit that was exceeded."""

    content: str  # of the buffer that overflowed
    size: str | None  # argument of `make_data` that enlarges the buffer


LIMITS = {
    Flag.NEFC: Limit("constraints of a world", "njmax"),
    Flag.NJMAX_NNZ: Limit("entries of the Jacobian of a world's constraints", "njmax"),
    Flag.BROADPHASE: Limit("pairs of geoms that are close to each other", "nconmax"),
    Flag.NARROWPHASE: Limit("contacts", "nconmax"),
    Flag.CCD: Limit("collisions of convex geoms", "nconmax"),
    Flag.HFIELD: Limit("contacts of one geom with a height field", None),
    Flag.EPA_HORIZON: Limit("edges of a polytope between two convex geoms", None),
    Flag.NVMAX: Limit("degrees of freedom that are awake", None),
}


class PhysicsOverflowError(RuntimeError):
    """A buffer of the physics overflowed: the physics of some steps was wrong.

    Attributes
    ----------
    sizes : dict of str to int
        The sizes that were too small, with their values: `njmax`, constraints of each world, and `nconmax`,
        contacts as an average over the worlds. Empty if the buffer has a fixed size.
    """

    def __init__(self, message: str, sizes: dict[str, int]) -> None:
        super().__init__(message)
        self.sizes = sizes


def check_overflow(flags: NDArray[np.int32], njmax: int, nconmax: int) -> None:
    """Raise if a buffer was too small in one of the worlds.

    Parameters
    ----------
    flags : array of shape [N]
        Overflow flags of each world.
    njmax, nconmax : int
        The current sizes.

    Raises
    ------
    PhysicsOverflowError
        If contacts or constraints were discarded.
    """
    harmful = flags & ~int(HARMLESS)
    if not harmful.any():
        return
    room = {"njmax": njmax, "nconmax": nconmax}
    causes, sizes = [], {}
    for flag in Flag(int(np.bitwise_or.reduce(harmful))):
        limit = LIMITS.get(flag, Limit("entries of a buffer that this version does not know", None))
        size = "a fixed size" if limit.size is None else f"{limit.size} = {room[limit.size]}"
        causes.append(f"{limit.content} ({flag.name}; {size})")
        if limit.size is not None:
            sizes[limit.size] = room[limit.size]
    worlds = int(np.count_nonzero(harmful))
    raise PhysicsOverflowError(
        f"{worlds} of {len(flags)} worlds had no room for all {' and '.join(causes)}", sizes
    )
