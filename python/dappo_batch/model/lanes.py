"""What the backend ``lanes`` does not support of a robot, and what in its TOML would change that."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from dappo_batch._core import lane_support
from dappo_batch.results import Reason

if TYPE_CHECKING:
    from dappo_batch.model.class_table import ClassTable

__all__ = ["support"]

_NAME = r"(?:joint|actuator|geom) `(?P<name>[^`]*)`(?P<more> and \d+ more)?"

# What a reason says, and the entry that removes it, with names from the reason.
_REMEDIES: tuple[tuple[str, str], ...] = (
    (r"touch each other by contype and conaffinity", "[simplify] self_collision = false"),
    (
        r"the contact of .* is not with a plane",
        "[simplify] self_collision = false, if both are parts of the robot",
    ),
    (r"opt\.integrator|in RK4 differently", '[simplify] integrator = "implicitfast"'),
    (rf"{_NAME}, the free one, has friction loss", "[[override]] joints = 'NAME', frictionloss = 0"),
    (rf"{_NAME} ha(?:s|ve) a (?:nonlinear|yielding) spring", "[[override]] joints = 'NAME', stiffness = 0"),
    (rf"{_NAME} ha(?:s|ve) nonlinear damping", "[[override]] joints = 'NAME', damping = VALUE"),
    (
        r"actuator activations|activation dynamics|a gain other than|a bias other than",
        '[[override]] actuators = PATTERN, control = "position" with kp, or "torque"',
    ),
    (r"power of solimp", "[[override]] geoms = '.*', solref and solimp"),
    (r"can touch the floor but (?:is|are) not", "[simplify] floor_contacts = [other geoms]"),
)


def support(table: ClassTable) -> tuple[tuple[Reason, ...], tuple[str, ...]]:
    """Return why the backend ``lanes`` does not support a robot, and notes on one that it supports.

    A note says in what the engine deliberately differs from the options of the MJCF.
    """
    reasons, notes = lane_support(table)
    return tuple(Reason(text, _remedy(text)) for text in reasons), tuple(notes)


def _remedy(text: str) -> str:
    for pattern, remedy in _REMEDIES:
        if found := re.search(pattern, text):
            named = found.groupdict(default="")
            parts = ".*" if named.get("more") else re.escape(named.get("name", ""))
            return remedy.replace("NAME", parts)
    return ""
