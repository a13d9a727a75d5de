"""What a report compares learners by: the forward reward, or the tracking of commanded velocities."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from dappo_batch.runs import Run
from dappo_batch.runs.tables import Table

__all__ = ["FORWARD_REWARD", "TRACKING", "Score", "score_of", "score_of_trace"]


@dataclass(frozen=True)
class Score:
    """What learners are compared by; more is better.

    Attributes
    ----------
    name, unit : str
        Its name and its unit.
    column, error : str
        Columns of an evaluation: its mean over episodes, and the standard error of that mean. Metrics have
        the same `column`.
    over_episodes : bool
        Whether the column of the metrics is a mean over episodes, else one over env steps.
    step_column, step_name, step_unit : str
        Column of a trace with its value in each step, and the name and unit of that.
    is_distance : bool
        Whether it is a sum of velocities: times the duration of an env step a distance.
    digits : int
        Decimals in tables.
    explanation : str
        Its definition.
    """

    name: str
    unit: str
    column: str
    error: str
    over_episodes: bool
    step_column: str
    step_name: str
    step_unit: str
    is_distance: bool
    digits: int
    explanation: str

    @property
    def title(self) -> str:
        """Its name at the beginning of a sentence."""
        return self.name.capitalize()

    @property
    def axis(self) -> str:
        """Its name on an axis."""
        return f"{self.name} ({self.unit})"

    @property
    def evaluation_column(self) -> str:
        """Column of the metrics with its mean over all damage classes, of evaluations during a training."""
        return f"evaluation_{self.column}"


FORWARD_REWARD = Score(
    name="forward reward",
    unit="sum of m/s",
    column="forward_reward",
    error="standard_error",
    over_episodes=True,
    step_column="forward_velocity",
    step_name="forward velocity",
    step_unit="m/s",
    is_distance=True,
    digits=1,
    explanation=(
        "Forward reward is the sum of the forward velocity (m/s) over the env steps of an episode: times "
        "the duration of an env step a distance in m, divided by the number of env steps a speed in m/s."
    ),
)
TRACKING = Score(
    name="tracking",
    unit="0 to 1",
    column="tracking",
    error="tracking_standard_error",
    over_episodes=False,
    step_column="tracking",
    step_name="tracking",
    step_unit="0 to 1",
    is_distance=False,
    digits=3,
    explanation=(
        "Tracking is how well commanded velocities are tracked, from 0 to 1: the mean of the reward term "
        "track_lin_vel, without its weight, over the env steps of an episode, 0 after a fall."
    ),
)


def score_of(run: Run) -> Score:
    """Return the score of a run: tracking if its reward has it, else the forward reward.

    Evaluations decide; the metrics, if there is none yet.
    """
    tables = list(run.per_class.values()) or [run.metrics]
    return TRACKING if any(_has_numbers(table, TRACKING.column) for table in tables) else FORWARD_REWARD


def score_of_trace(table: Table) -> Score:
    """Return the score of a trace: tracking if its reward has it, else the forward velocity."""
    return TRACKING if TRACKING.step_column in table else FORWARD_REWARD


def _has_numbers(table: Table, column: str) -> bool:
    # A reward without `track_lin_vel` has only missing values.
    return column in table and table[column].dtype.kind in "if" and bool(np.isfinite(table[column]).any())
