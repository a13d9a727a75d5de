"""What is called many times in one process keeps no memory."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path

import pytest

import dappo_batch
from dappo_batch.commands import TrainingOptions

CALLS = 8
OPTIONS: TrainingOptions = {
    "threads": 1,
    "num_envs": 4,
    "total_steps": 64,
    "set": {
        "horizon": 16,
        "env.max_episode_steps": 20,
        # Networks of 200 kB: one that stays would show.
        "ppo.hidden": [128, 128],
        "evaluation.episodes": 1,
        "damage": {"types": ["jammed_joint"], "max_damaged_limbs": 1},
    },
}


class _Mallinfo2(ctypes.Structure):
    _fields_ = [
        (name, ctypes.c_size_t)
        for name in (
            *("arena", "ordblks", "smblks", "hblks", "hblkhd"),
            *("usmblks", "fsmblks", "uordblks", "fordblks", "keepcost"),
        )
    ]


@pytest.fixture(scope="module")
def bytes_in_use() -> Callable[[], int]:
    """Ask glibc how many bytes are allocated."""
    mallinfo2 = getattr(ctypes.CDLL(None), "mallinfo2", None)
    if mallinfo2 is None:
        pytest.skip("no glibc of 2.33 or newer")
    mallinfo2.restype = _Mallinfo2

    def measure() -> int:
        info = mallinfo2()
        return int(info.uordblks + info.hblkhd)

    return measure


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train for one iteration."""
    folder = tmp_path_factory.mktemp("memory") / "run"
    dappo_batch.train(folder, **OPTIONS)
    return folder


def _evaluate(run: Path) -> None:
    dappo_batch.evaluate(run, threads=1)


def _resume(run: Path) -> None:
    dappo_batch.resume(run, threads=1)


def _load_policy(run: Path) -> None:
    dappo_batch.Policy.load(run)


def _make_envs(_: Path) -> None:
    envs = dappo_batch.make_vec("ant", num_envs=4, damage="uniform", threads=1)
    envs.reset(seed=0)
    envs.step(envs.action_space.sample())
    envs.close()


@pytest.mark.parametrize("call", [_evaluate, _resume, _load_policy, _make_envs])
def test_calls_keep_no_memory(
    call: Callable[[Path], None], run: Path, bytes_in_use: Callable[[], int]
) -> None:
    for _ in range(3):
        call(run)
    growths = []
    for _ in range(3):
        before = bytes_in_use()
        for _ in range(CALLS):
            call(run)
        growths.append((bytes_in_use() - before) / CALLS)
    # What other threads of the tests take meanwhile they take once; what a call keeps, every one keeps.
    assert min(growths) < 8000, f"{growths} bytes a call"
