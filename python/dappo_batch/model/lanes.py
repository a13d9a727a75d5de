"""Why the backend ``lanes`` does not support a robot, and what in its TOML would change that."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from dappo_batch._core import lane_refusals
from dappo_batch.results import Reason

if TYPE_CHECKING:
    from dappo_batch.model.class_table import ClassTable

__all__ = ["reasons"]

_NAME = r"(?:joint|actuator|geom) `(?P<name>[^`]*)`"

# What a reason says, and the entry that removes it, with names from the reason.
_REMEDIES: tuple[tuple[str, str], ...] = (
    (r"touch each other by contype and conaffinity", "[simplify] self_collision = false"),
    (
        r"the contact of .* is not with a plane",
        "[simplify] self_collision = false, if both are parts of the robot",
    ),
    (r"elliptic friction cones", '[simplify] cone = "pyramidal"'),
    (r"opt\.impratio", "[simplify] impratio = 1"),
    (r"opt\.integrator|in RK4 differently", '[simplify] integrator = "implicitfast"'),
    (r"condim \d", "[simplify] condim = 3"),
    (rf"{_NAME}, the free one, has (?P<entry>\w+)", "[[override]] joints = 'NAME', ENTRY = 0"),
    (rf"{_NAME} has friction loss", "[[override]] joints = 'NAME', frictionloss = 0"),
    (rf"{_NAME} has (?:a|a nonlinear|a yielding) spring", "[[override]] joints = 'NAME', stiffness = 0"),
    (rf"{_NAME} has nonlinear damping", "[[override]] joints = 'NAME', damping = VALUE"),
    (
        r"actuator activations|activation dynamics|a gain other than|a bias other than",
        '[[override]] actuators = PATTERN, control = "position" with kp, or "torque"',
    ),
    (r"differ in solref or solimp|power of solimp", "[[override]] geoms = '.*', solref and solimp"),
    (r"can touch the floor but is not", "[simplify] floor_contacts = [other geoms]"),
)


def reasons(table: ClassTable) -> tuple[Reason, ...]:
    """Return all reasons why the backend ``lanes`` does not support a robot; empty if it does."""
    return tuple(Reason(text, _remedy(text)) for text in lane_refusals(table))


def _remedy(text: str) -> str:
    for pattern, remedy in _REMEDIES:
        if found := re.search(pattern, text):
            named = found.groupdict(default="")
            remedy = remedy.replace("NAME", re.escape(named.get("name", "")))
            return remedy.replace("ENTRY", named.get("entry", ""))
    return ""
