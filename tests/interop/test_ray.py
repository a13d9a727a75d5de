"""A sweep on a Ray cluster of several nodes, one of which is lost during the sweep."""

from __future__ import annotations

import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

ray = pytest.importorskip("ray", reason="needs the extra `ray`: pip install dappo-batch[ray]")

from ray.cluster_utils import Cluster

import dappo_batch
from dappo_batch.sweeps.ray import RayExecutor

pytestmark = [pytest.mark.interop, pytest.mark.filterwarnings("ignore")]

ITERATIONS = 300
BASE = {
    "threads": 1,
    "num_envs": 4,
    "total_steps": 64 * ITERATIONS,
    "horizon": 16,
    "ppo.hidden": [8],
    "evaluation.episodes": 1,
    "damage.max_damaged_limbs": 0,
    "env.max_episode_steps": 20,
    "checkpoint.every": 10,
}


@pytest.fixture
def cluster() -> Iterator[tuple[Any, Any]]:
    """Return a cluster whose head does no work, and one of its two workers."""
    cluster = Cluster()
    try:
        cluster.add_node(num_cpus=0)
        doomed = cluster.add_node(num_cpus=1)
        cluster.add_node(num_cpus=1)
        cluster.wait_for_nodes()
        ray.init(address=cluster.address, log_to_driver=False)
        yield cluster, doomed
    finally:
        # Also what was started before a node failed to come up.
        ray.shutdown()
        cluster.shutdown()


def test_a_lost_node_loses_no_cell_and_repeats_none(cluster: tuple[Any, Any], tmp_path: Path) -> None:
    nodes, doomed = cluster
    out, seeds = tmp_path / "sweep", [0, 1, 2]

    def progress(seed: int) -> int:
        lines = out / f"seed={seed}" / "metrics.jsonl"
        return lines.read_text().count("\n") if lines.exists() else 0

    with ThreadPoolExecutor(1) as thread:
        sweep = thread.submit(dappo_batch.sweep, BASE, {"seed": seeds}, out, executor=RayExecutor())
        deadline = time.monotonic() + 240
        while sum(20 < progress(seed) < ITERATIONS for seed in seeds) < 2:
            assert time.monotonic() < deadline
            assert not sweep.done(), sweep.result()
            time.sleep(0.02)
        nodes.remove_node(doomed, allow_graceful=False)
        cells = sweep.result(timeout=600)
    assert [cell.error for cell in cells] == [None] * len(seeds)
    for cell in cells:
        run = cell.run()
        # No iteration is missing, and none was done once more after the run went on.
        assert run.metrics["iteration"].tolist() == list(range(1, ITERATIONS + 1))
        assert "true" in run.per_class
