"""CleanRL's program trains on the Gymnasium id."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("cleanrl")

from .program import run_program

pytestmark = pytest.mark.interop

# CleanRL 1.2.0 is older than Gymnasium 1.0, whose TransformObservation also wants the new observation space.
# Without it the program stops before its first step, whatever the env.
RUN = """
import runpy
import gymnasium

wrapper = gymnasium.wrappers.TransformObservation
gymnasium.wrappers.TransformObservation = lambda env, func: wrapper(env, func, env.observation_space)
runpy.run_module("cleanrl.ppo_continuous_action", run_name="__main__")
"""


def test_ppo_continuous_action_trains_to_its_end(tmp_path: Path) -> None:
    sizes = ["--total-timesteps", "128", "--num-envs", "2", "--num-steps", "32", "--num-minibatches", "2"]
    env_id = "dappo_batch:dappo_batch/Ant-v0"  # Gymnasium imports what stands before the colon
    command = ["-c", RUN, "--env-id", env_id, *sizes, "--update-epochs", "1", "--cuda", "False"]
    printed = run_program(command, tmp_path)
    assert printed.count("SPS:") == 2  # once for each of its updates
    assert list(tmp_path.glob("runs/*/*/events.out.*"))
