"""A smoke test of an installed wheel.

No test of pytest's: `make wheels` runs it with the Python of an environment that holds nothing else.
"""

from __future__ import annotations

import contextlib
import tempfile
from pathlib import Path

import dappo_batch
from dappo_batch._core import run_cli

SMALL = ("--envs", "8", "--set", "horizon=32", "env.max_episode_steps=40", "evaluation.episodes=1")
FILES = (
    *("py.typed", "_core.pyi", "robots/hexapod.xml", "configs/ant.toml"),
    *("kernels/engine.py", "report/page.css", "report/page.js"),
)


def run(*arguments: str) -> None:
    """Run a command, which must succeed."""
    code = run_cli(arguments)
    assert code == 0, f"`dappo-batch {' '.join(arguments)}` ended with {code}"


def main() -> None:
    """Check for the files that are not code, then train and evaluate each robot with each backend."""
    package = Path(dappo_batch.__file__).parent
    missing = [name for name in FILES if not (package / name).is_file()]
    assert not missing, f"{package} lacks {missing}"
    run("doctor")
    for robot in dappo_batch.ROBOTS:
        for backend in ("mujoco", "lanes"):
            folder = f"{robot}_{backend}"
            run(*("train", "--robot", robot, "--backend", backend, "--run", folder, "--steps", "512"), *SMALL)
            run("evaluate", folder, "--episodes", "1", "--backend", backend)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        main()
    print(f"dappo-batch {dappo_batch.__version__} works")
