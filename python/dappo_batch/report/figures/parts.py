"""Common parts of figures: a legend of learners, and an axis in metres."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from matplotlib.axes import Axes

from dappo_batch.report.learners import Learner
from dappo_batch.report.picture import Key
from dappo_batch.report.theme import MUTED, Mark, mark

__all__ = ["keys", "metres"]


def keys(learners: Sequence[Learner], *, lines: bool) -> tuple[Key, ...]:
    """Return the legend of some learners, as lines or as markers."""
    marks = [mark(learner.place) for learner in learners]
    found = [Mark(one.colour, one.dash) if lines else Mark(one.colour, "", one.marker) for one in marks]
    return tuple(Key(learner.label(), one) for learner, one in zip(learners, found, strict=True))


def metres(axes: Axes, seconds: float | None, direction: Literal["x", "y"] = "y") -> None:
    """Add a second axis in m to one of forward rewards, or none without the duration of an env step, s."""
    if seconds is None:
        return
    functions = (lambda rewards: rewards * seconds, lambda distances: distances / seconds)
    if direction == "y":
        second = axes.secondary_yaxis("right", functions=functions)
        second.set_ylabel("distance, m", color=MUTED)
    else:
        second = axes.secondary_xaxis("top", functions=functions)
        second.set_xlabel("distance, m", color=MUTED)
    second.spines[:].set_visible(False)
    second.tick_params(colors=MUTED, labelcolor=MUTED)
