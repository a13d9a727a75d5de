"""The learner's share: how much of a training iteration is simulation and how much is learning."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from statistics import median
from typing import Any

__all__ = ["LearnerShare", "learner_share"]

_TRAIN = "from dappo_batch.cli import main; main()"
_STEPS = 200_000  # a few iterations of the configurations that come with the robots


@dataclass(frozen=True)
class LearnerShare:
    """Where the time of a training iteration goes.

    Attributes
    ----------
    rollout_seconds, update_seconds : float
        Median time of an iteration spent collecting and learning, s; 0 if training failed.
    iterations : int
        Iterations behind the medians; the first is left out, because it warms up.
    num_envs, horizon : int
        Size of the rollout, as the robot's own configuration has it.
    error : str
        Why there are no numbers; empty if there are.
    """

    rollout_seconds: float = 0.0
    update_seconds: float = 0.0
    iterations: int = 0
    num_envs: int = 0
    horizon: int = 0
    error: str = ""

    @property
    def share(self) -> float:
        """Fraction of an iteration spent learning."""
        total = self.rollout_seconds + self.update_seconds
        return self.update_seconds / total if total > 0.0 else 0.0

    def as_dict(self) -> dict[str, Any]:
        """Return everything as JSON can hold it."""
        return asdict(self) | {"share": self.share}


def learner_share(
    robot: str, threads: int, *, steps: int = _STEPS, settings: Sequence[str] = (), timeout: float = 600.0
) -> LearnerShare:
    """Train for a few iterations in a process of its own and read its metrics.

    Failure is an answer too: `LearnerShare.error` then says what went wrong.

    Parameters
    ----------
    robot : str
        Name or path of the robot.
    threads : int
        Threads that simulate.
    steps : int
        Env steps to train for.
    settings : sequence of str
        Further settings of the run, such as ``"horizon=16"``.
    timeout : float
        Longest time to wait, s.
    """
    with tempfile.TemporaryDirectory(prefix="dappo-batch-bench-") as folder:
        run = Path(folder) / "run"
        command = [sys.executable, "-c", _TRAIN, "train", "--robot", robot, "--run", str(run), "--json"]
        command += ["--threads", str(threads), "--steps", str(steps)]
        for setting in ("evaluation.episodes=1", *settings):
            command += ["--set", setting]
        try:
            done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout)
        except subprocess.TimeoutExpired:
            return LearnerShare(error=f"training took longer than {timeout:.0f} s")
        if done.returncode != 0:
            said = (done.stderr.strip() or done.stdout.strip() or "it said nothing")[-500:]
            return LearnerShare(error=f"`dappo-batch train` ended with exit code {done.returncode}: {said}")
        return _read(run)


def _read(run: Path) -> LearnerShare:
    try:
        config = tomllib.loads((run / "config.toml").read_text(encoding="utf-8"))
        num_envs, horizon = int(config["env"]["num_envs"]), int(config["horizon"])
        rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text(encoding="utf-8").splitlines()]
        times = [(float(row["rollout_seconds"]), float(row["update_seconds"])) for row in rows]
    except (OSError, ValueError, KeyError) as error:
        return LearnerShare(error=f"the run folder does not say it: {type(error).__name__}: {error}")
    if not times:
        return LearnerShare(error="the run has no metrics: training ended before its first iteration")
    times = times[1:] or times
    return LearnerShare(
        rollout_seconds=median(rollout for rollout, _ in times),
        update_seconds=median(update for _, update in times),
        iterations=len(times),
        num_envs=num_envs,
        horizon=horizon,
    )
