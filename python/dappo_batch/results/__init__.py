"""Results of functions, as frozen dataclasses.

Those of commands contain the output of ``--json``. `Event`, `Change` and `Meta` are read from JSON by their
`from_dict`.

A forward reward is the mean over episodes of the sum of forward velocities, m/s. Undefined values, such as
the standard error of a single episode, are None.
"""

from __future__ import annotations

from dappo_batch.results.adaptation import (
    AdaptationReport,
    AdaptationSummary,
    AssumedClass,
    ClassOutcome,
    DecisionTime,
    Event,
    Trial,
)
from dappo_batch.results.base import Result
from dappo_batch.results.diagnosis import Cost, DiagnoserReport, DiagnosisSummary, EpochMetrics, Mistake
from dappo_batch.results.evaluation import (
    ClassComparison,
    ClassResult,
    Comparison,
    ComparisonSummary,
    Estimate,
    EvaluationReport,
    Gain,
    GroupResult,
    RunEvaluation,
    RunSummary,
    Side,
)
from dappo_batch.results.robots import ActuatorInfo, Edit, JointInfo, Reason, RobotReport
from dappo_batch.results.runs import Change, Meta

__all__ = [
    "ActuatorInfo",
    "AdaptationReport",
    "AdaptationSummary",
    "AssumedClass",
    "Change",
    "ClassComparison",
    "ClassOutcome",
    "ClassResult",
    "Comparison",
    "ComparisonSummary",
    "Cost",
    "DecisionTime",
    "DiagnoserReport",
    "DiagnosisSummary",
    "Edit",
    "EpochMetrics",
    "Estimate",
    "EvaluationReport",
    "Event",
    "Gain",
    "GroupResult",
    "JointInfo",
    "Meta",
    "Mistake",
    "Reason",
    "Result",
    "RobotReport",
    "RunEvaluation",
    "RunSummary",
    "Side",
    "Trial",
]
