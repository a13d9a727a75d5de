"""What the overflow flags of `mujoco_warp` mean for a run, and which size to raise."""

from __future__ import annotations

from typing import NamedTuple

import mujoco_warp as mjw
import numpy as np
from numpy.typing import NDArray

__all__ = ["PhysicsOverflowError", "check_overflow"]

Flag = mjw.OverflowType

# A solver that has used up its iterations goes on with what it has, as MuJoCo's does, and many robots ask for
# few. The last two concern sensors that no observation and no reward reads.
HARMLESS = Flag.ITERATIONS | Flag.LS_ITERATIONS | Flag.CONTACT_MATCH | Flag.TACTILE


class Limit(NamedTuple):
    """A limit that was exceeded."""

    what: str  # there was no room for
    size: str | None  # of `make_data`, which gives more room


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
    """More of something than there is room for: the physics of some steps was wrong.

    Attributes
    ----------
    sizes : dict of str to int
        The sizes that were too small, with their values: `njmax`, constraints of a world, and `nconmax`,
        contacts a world on average. Empty where no size gives more room.
    """

    def __init__(self, message: str, sizes: dict[str, int]) -> None:
        super().__init__(message)
        self.sizes = sizes


def check_overflow(flags: NDArray[np.int32], njmax: int, nconmax: int) -> None:
    """Raise if there was too little room in one of the worlds.

    Parameters
    ----------
    flags : array of shape [N]
        Overflow flags of each world.
    njmax, nconmax : int
        The room there was.

    Raises
    ------
    PhysicsOverflowError
        If something was left out of the physics.
    """
    harmful = flags & ~int(HARMLESS)
    if not harmful.any():
        return
    room = {"njmax": njmax, "nconmax": nconmax}
    causes, sizes = [], {}
    for flag in Flag(int(np.bitwise_or.reduce(harmful))):
        limit = LIMITS.get(flag, Limit("something that this version does not know", None))
        size = "a fixed size" if limit.size is None else f"{limit.size} = {room[limit.size]}"
        causes.append(f"{limit.what} ({flag.name}; {size})")
        if limit.size is not None:
            sizes[limit.size] = room[limit.size]
    worlds = int(np.count_nonzero(harmful))
    raise PhysicsOverflowError(
        f"{worlds} of {len(flags)} worlds had no room for all {' and '.join(causes)}", sizes
    )
