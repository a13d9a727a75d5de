"""A sweep with submitit, whose local executor starts jobs as on Slurm."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("submitit", reason="needs the extra `slurm`: pip install dappo-batch[slurm]")

import dappo_batch
from dappo_batch.sweeps.slurm import SlurmExecutor

pytestmark = [pytest.mark.interop, pytest.mark.filterwarnings("ignore")]

BASE = {
    "threads": 1,
    "num_envs": 4,
    "total_steps": 128,
    "horizon": 16,
    "ppo.hidden": [8],
    "evaluation.episodes": 1,
    "damage.max_damaged_limbs": 0,
    "env.max_episode_steps": 20,
}


def test_jobs_train_the_cells_and_a_failure_arrives(tmp_path: Path) -> None:
    with SlurmExecutor(tmp_path / "jobs", cluster="local", timeout_min=5) as executor:
        cells = dappo_batch.sweep(BASE, {"ppo.gamma": [0.9, 2.0]}, tmp_path / "sweep", executor=executor)
    assert cells[0].error is None
    assert cells[0].run().metrics["env_steps"].tolist() == [64, 128]
    assert "gamma" in (cells[1].error or "")


def test_cancelled_jobs_end(tmp_path: Path) -> None:
    executor = SlurmExecutor(tmp_path / "jobs", cluster="local", timeout_min=5)
    future = executor.submit(
        dappo_batch.sweeps.worker.train_cell, str(tmp_path / "run"), {"total_steps": 10**9}
    )
    executor.shutdown(cancel_futures=True)
    assert future.exception() is not None
