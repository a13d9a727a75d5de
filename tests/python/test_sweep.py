"""Sweeps: every cell is trained once, whatever happens on the way."""

from __future__ import annotations

import sys
import time
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

import dappo_batch
from dappo_batch import ConfigError
from dappo_batch.sweeps import sweep
from dappo_batch.sweeps.cell import options_of

from .. import processes
from .command_line import ITERATION, dappo_batch_many, files, metrics, start

BASE = {
    "threads": 1,
    "num_envs": 4,
    "total_steps": 2 * ITERATION,
    "horizon": 16,
    "env.max_episode_steps": 20,
    "ppo.hidden": [8],
    "evaluation.episodes": 1,
    "damage.max_damaged_limbs": 0,
}
GRID = {"seed": [0, 1], "unaware": [False, True]}


class Inline(Executor):
    """Runs calls at once, and counts them."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    def submit(self, fn: Any, /, *args: Any, **kwargs: Any) -> Future[Any]:  # noqa: ANN401
        future: Future[Any] = Future()
        self.calls.append(args[0])
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def test_every_combination_is_trained_as_if_alone_and_never_again(tmp_path: Path) -> None:
    ended: list[Path] = []
    cells = sweep(
        BASE, GRID, tmp_path / "sweep", executor=Inline(), callback=lambda cell: ended.append(cell.path)
    )
    assert [cell.values for cell in cells] == [
        {"seed": seed, "unaware": unaware} for seed in (0, 1) for unaware in (False, True)
    ]
    assert [cell.path.name for cell in cells] == [
        *("seed=0,unaware=false", "seed=0,unaware=true", "seed=1,unaware=false", "seed=1,unaware=true"),
    ]
    assert sorted(ended) == sorted(cell.path for cell in cells)
    assert [(cell.run().seed, cell.run().observes_damage) for cell in cells] == [
        *((0, True), (0, False), (1, True), (1, False)),
    ]
    options = {"threads", "num_envs", "total_steps"}
    settings = {key: value for key, value in BASE.items() if key not in options}
    alone = dappo_batch.train(
        tmp_path / "alone",
        threads=1,
        num_envs=4,
        total_steps=2 * ITERATION,
        seed=1,
        unaware=True,
        set=settings,
    )
    assert metrics(cells[3].path) == metrics(alone.path)

    before = files(tmp_path / "sweep")
    again = sweep(BASE, GRID | {"seed": [1, 2]}, tmp_path / "sweep", executor=Inline())
    assert [cell.error for cell in again] == [None] * 4
    after = files(tmp_path / "sweep")
    assert {name: after[name] for name in before} == before
    assert {Path(name).parts[0] for name in after.keys() - before.keys() if not name.endswith(".lock")} == {
        *("seed=2,unaware=false", "seed=2,unaware=true"),
    }


def test_a_failed_cell_has_its_error_and_does_not_stop_the_others(tmp_path: Path) -> None:
    cells = sweep(BASE, {"ppo.gamma": [2.0, 0.9]}, tmp_path / "sweep", executor=Inline())
    assert "ConfigError" in (cells[0].error or "")
    assert "gamma" in (cells[0].error or "")
    assert cells[1].error is None
    assert len(cells[1].run().metrics["kl"]) == 2


@pytest.mark.slow
def test_a_sweep_whose_process_is_killed_resumes_with_the_missing_cells(tmp_path: Path) -> None:
    out = tmp_path / "sweep"
    base = ("steps=6400", "envs=4", "threads=1", "horizon=16", "ppo.hidden=[8]", "evaluation.episodes=1")
    command = (
        *("sweep", "--out", out, "--jobs", "2", "--grid", "seed=0,1,2", "--base", *base),
        *("damage.max_damaged_limbs=0", "env.max_episode_steps=20", "checkpoint.every=5"),
    )
    process = start(*command)
    begun = out / "seed=1" / "metrics.jsonl"
    deadline = time.monotonic() + 60
    while not (begun.exists() and begun.read_text().count("\n") >= 7):
        assert process.poll() is None
        assert time.monotonic() < deadline
        time.sleep(0.01)
    processes.end(process)  # and its workers
    ((code, printed, _),) = dappo_batch_many(command)
    assert code == 0
    assert printed.startswith("3 of 3 trainings completed")
    straight = dappo_batch.load_run(out / "seed=1")
    assert straight.metrics["iteration"].tolist() == list(range(1, 101))
    assert "true" in straight.per_class


def test_another_base_and_an_empty_grid_are_rejected(tmp_path: Path) -> None:
    sweep(BASE, {"seed": [0]}, tmp_path / "sweep", executor=Inline())
    with pytest.raises(ConfigError, match="another base"):
        sweep(BASE | {"num_envs": 8}, {"seed": [0]}, tmp_path / "sweep", executor=Inline())
    with pytest.raises(ConfigError, match="no values for seed"):
        sweep(BASE, {"seed": []}, tmp_path / "other", executor=Inline())
    with pytest.raises(ConfigError, match="two cells"):
        sweep(BASE, {"seed": [0, 0]}, tmp_path / "other", executor=Inline())


def test_an_option_that_is_none_is_left_out(tmp_path: Path) -> None:
    executor = Inline()
    cells = sweep(BASE | {"reward": None}, {"seed": [0]}, tmp_path / "sweep", executor=executor)
    assert cells[0].error is None
    assert sweep(BASE, {"seed": [0]}, tmp_path / "sweep", executor=executor) == cells


@pytest.mark.slow
def test_two_processes_cannot_train_one_run(tmp_path: Path) -> None:
    def train(_: int) -> str:
        options = {
            "threads": 1,
            "num_envs": 4,
            "total_steps": 200 * ITERATION,
            "set": {"horizon": 16, "ppo.hidden": [8]},
        }
        program = f"import dappo_batch; dappo_batch.train({str(tmp_path / 'run')!r}, **{options!r})"
        return processes.run([sys.executable, "-c", program], timeout=120).stderr

    with ThreadPoolExecutor(2) as pool:
        errors = list(pool.map(train, range(2)))
    assert sorted(bool(error) for error in errors) == [False, True]
    assert any("already holds a run" in error or "trained by another process" in error for error in errors)


def test_options_have_their_own_names_and_those_of_flags() -> None:
    options = {"num_envs": 4, "total_steps": 64, "set": {"ppo.gamma": 0.9}}
    assert options_of({"num_envs": 4, "total_steps": 64, "ppo.gamma": 0.9}) == options
    assert options_of({"envs": 4, "steps": 64, "ppo.gamma": 0.9}) == options
    with pytest.raises(ConfigError, match="num_envs is given twice, also by the name of its flag"):
        options_of({"envs": 4, "num_envs": 4})
