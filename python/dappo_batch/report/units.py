"""Duration of an env step, to convert forward rewards to metres."""

from __future__ import annotations

from dappo_batch._core import DappoError
from dappo_batch.model.mujoco_library import quiet_mujoco
from dappo_batch.model.robot_spec import read_robot_spec
from dappo_batch.robots import load_robot
from dappo_batch.robots.copies import COPY_TOML
from dappo_batch.runs import Run
from dappo_batch.runs.robot_of_run import COPY

__all__ = ["step_seconds"]


def step_seconds(run: Run) -> float | None:
    """Return the duration of an env step, s; None if the robot of the run cannot be read.

    A forward reward, the sum of the forward velocity (m/s) over steps, times this is a distance in m.
    """
    copy = run.path / COPY / COPY_TOML
    try:
        robot = load_robot(copy if copy.is_file() else run.robot)
        with quiet_mujoco():
            timestep = float(read_robot_spec(robot)[0].option.timestep)
    except (DappoError, OSError):
        return None
    return timestep * int(robot.spec["frame_skip"])
