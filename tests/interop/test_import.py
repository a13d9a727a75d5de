"""The programs behind the adaptors stay optional."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = pytest.mark.interop


def test_importing_the_package_imports_none_of_the_programs() -> None:
    others = ("torch", "stable_baselines3", "rsl_rl", "tensordict", "torchrl", "skrl")
    check = (
        f"import sys, dappo_batch, dappo_batch.interop; sys.exit(bool({set(others)!r} & set(sys.modules)))"
    )
    assert subprocess.run([sys.executable, "-c", check], check=False).returncode == 0
