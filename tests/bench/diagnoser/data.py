"""The dataset of the benchmark, collected with the commands of this package."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from dappo_batch._core import SimulationError

from ..commands import TrainingFailed, command_line

__all__ = ["Dataset", "collect"]

# The training time of a diagnoser does not depend on how well the expert walks.
_EXPERT_STEPS = 512
_EXPERT_SIZES = ("--envs", "16", "--set", "horizon=32", "evaluation.episodes=1")


@dataclass(frozen=True)
class Dataset:
    """Pairs of damaged robots and their healthy twins.

    Attributes
    ----------
    folder : Path
        Folder of the dataset.
    classes : int
        Damage classes C.
    inputs : int
        Length of an observation, O.
    """

    folder: Path
    classes: int
    inputs: int


def collect(robot: str, rollouts: int, timesteps: int, threads: int, folder: Path) -> Dataset:
    """Train an expert briefly, and collect pairs of damaged robots and healthy twins with it.

    Parameters
    ----------
    robot : str
        Name or path of the robot.
    rollouts : int
        Rollouts, each with a window of every damage class.
    timesteps : int
        Steps of a window.
    threads : int
        Threads of the simulation.
    folder : Path
        Folder for expert and dataset.

    Raises
    ------
    SimulationError
        If a command fails.
    """
    expert, data = folder / "expert", folder / "data"
    common = ["--threads", str(threads)]
    sizes = ["--preset", "paper", "--rollouts", str(rollouts), "--timesteps", str(timesteps)]
    # Episodes as short as a window: the run ends with an evaluation, which is not needed here.
    short_end = f"env.max_episode_steps={timesteps}"
    steps = ["--steps", str(_EXPERT_STEPS), "--run", str(expert)]
    try:
        command_line(
            ["train", "--healthy", "--robot", robot, *common, *steps, *_EXPERT_SIZES, short_end], threads
        )
        command_line(["diagnose", "collect", str(expert), "--out", str(data), *common, *sizes], threads)
    except TrainingFailed as error:
        raise SimulationError(f"the dataset cannot be collected: {error}") from error
    header = json.loads((data / "dataset.json").read_text(encoding="utf-8"))
    return Dataset(data, classes=len(header["subject"]["class_names"]), inputs=int(header["obs_dim"]))
