"""The valid files from which inputs are generated, and fixed seeds."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

from .fuzz.room import prepare

settings.register_profile(
    "gate",
    derandomize=True,
    database=None,
    deadline=None,
    suppress_health_check=[
        HealthCheck.function_scoped_fixture,
        HealthCheck.too_slow,
        HealthCheck.data_too_large,
    ],
)
settings.load_profile("gate")


@pytest.fixture(scope="session")
def valid_files(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Create a tiny run, diagnoser, dataset and export."""
    base = tmp_path_factory.mktemp("valid") / "base"
    before = Path.cwd()
    prepare(base)
    yield base
    os.chdir(before)
