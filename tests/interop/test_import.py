"""The libraries of the adaptors are optional."""

from __future__ import annotations

import sys

import pytest

from .. import processes

pytestmark = pytest.mark.interop


def test_importing_the_package_imports_none_of_the_programs() -> None:
    others = ("torch", "stable_baselines3", "rsl_rl", "tensordict", "torchrl", "skrl")
    check = (
        f"import sys, dappo_batch, dappo_batch.interop; sys.exit(bool({set(others)!r} & set(sys.modules)))"
    )
    assert processes.run([sys.executable, "-c", check], timeout=120).returncode == 0
