"""Backends, trained networks and an OpenGL that tests share."""

from __future__ import annotations

from pathlib import Path

import pytest

import dappo_batch
from dappo_batch import render
from dappo_batch.render import RenderError, Walk

from .command_line import dappo_batch_many

CONTROLLER_SIZES = (
    *("--threads", "2", "--envs", "256", "--set", "horizon=32", "ppo.hidden=[32]", "ppo.schedule=constant"),
    *("damage.max_damaged_limbs=1", "evaluation.episodes=1", "env.max_episode_steps=200"),
)


@pytest.fixture(params=["lanes", "mujoco"])
def backend(request: pytest.FixtureRequest) -> str:
    """Run the test once with each backend."""
    name: str = request.param
    return name


@pytest.fixture(scope="session")
def parts(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Train a policy that moves, another one, and a diagnoser of single damages that is mostly correct."""
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
def opengl() -> None:
    """Skip a test if no OpenGL implementation works."""
    table = dappo_batch.compile_class_table("ant", max_damaged_limbs=1)
    try:
        list(render.frames(Walk(table, table.models[0].qpos0), [0], size=(32, 24), captioned=False))
    except RenderError as error:
        pytest.skip(str(error))
