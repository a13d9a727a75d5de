"""Compiled robots shared by all tests, and an exact comparison of what environments return."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import dappo_batch
from dappo_batch import ClassTable

from .command_line import dappo_batch_many

CONTROLLER_SIZES = (
    *("--threads", "2", "--envs", "256", "--set", "horizon=32", "ppo.hidden=[32]"),
    *("damage.max_damaged_limbs=1", "evaluation.episodes=1", "env.max_episode_steps=200"),
)


@pytest.fixture(params=["lanes", "mujoco"])
def backend(request: pytest.FixtureRequest) -> str:
    """Run the test once with each backend."""
    name: str = request.param
    return name


@pytest.fixture(scope="session")
def nervous_tables(tmp_path_factory: pytest.TempPathFactory) -> dict[str, ClassTable]:
    """Compile both robots with an allowed height so narrow that episodes often end by themselves."""
    folder = tmp_path_factory.mktemp("robots") / "nervous"
    shutil.copytree(Path(dappo_batch.load_robot("ant").path).parent, folder)
    tables = {}
    for name, height in (("ant", "[0.45, 0.8]"), ("hexapod", "[0.185, 0.215]")):
        robot = folder / f"{name}.toml"
        text, count = re.subn(r"(?m)^height = .*$", f"height = {height}", robot.read_text())
        assert count == 1
        robot.write_text(text)
        tables[name] = dappo_batch.compile_class_table(robot)
    return tables


@pytest.fixture(scope="session")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train a policy that moves, another one, and a diagnoser of single damages that is mostly right."""
    root = tmp_path_factory.mktemp("controller")
    windows = ("--preset", "residual", "--timesteps", "20", "--onset", "20-60", "--delay", "5-40")
    network = ("epochs=15", "schedule=cosine", "embedding=32", "lstm=16", "hidden=[32]")
    done = dappo_batch_many(
        ("train", *CONTROLLER_SIZES, "--steps", "196608", "--run", root / "aware"),
        ("train", *CONTROLLER_SIZES, "--healthy", "--steps", "8192", "--run", root / "expert"),
        ("diagnose", "collect", root / "aware", *windows, "--rollouts", "300", "--out", root / "pairs"),
        ("diagnose", "train", root / "pairs", "--out", root / "diagnoser", "--set", *network),
    )
    assert [code for code, _, _ in done] == [0] * len(done), done
    return root


@pytest.fixture(scope="session")
def assert_identical() -> Callable[..., None]:
    """Give tests the exact comparison."""
    return _assert_identical


def _assert_identical(left: Any, right: Any, where: str = "") -> None:  # noqa: ANN401
    """Compare nested tuples, dicts and arrays bit for bit, types and shapes included."""
    if isinstance(left, dict):
        assert isinstance(right, dict), where
        assert sorted(left) == sorted(right), where
        for key in left:
            _assert_identical(left[key], right[key], f"{where}[{key!r}]")
    elif isinstance(left, tuple):
        assert len(left) == len(right), where
        for index, (one, other) in enumerate(zip(left, right, strict=True)):
            _assert_identical(one, other, f"{where}[{index}]")
    elif isinstance(left, np.ndarray):
        assert isinstance(right, np.ndarray), where
        assert (left.dtype, left.shape) == (right.dtype, right.shape), where
        if left.dtype == object:
            for index, (one, other) in enumerate(zip(left, right, strict=True)):
                _assert_identical(one, other, f"{where}[{index}]")
        else:
            np.testing.assert_array_equal(left, right, err_msg=where)
    else:
        assert type(left) is type(right), where
        assert left == right, where
