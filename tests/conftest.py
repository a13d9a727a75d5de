"""Compiled robots shared by all tests."""

from __future__ import annotations

import pytest

import dappo_batch
from dappo_batch import ClassTable


@pytest.fixture(scope="session")
def ant_table() -> ClassTable:
    """Compile all 33 classes of the Ant."""
    return dappo_batch.compile_class_table("ant")


@pytest.fixture(scope="session")
def hexapod_table() -> ClassTable:
    """Compile all 73 classes of the Hexapod."""
    return dappo_batch.compile_class_table("hexapod")


@pytest.fixture(params=["ant", "hexapod"])
def table(request: pytest.FixtureRequest) -> ClassTable:
    """Run the test once with each shipped robot."""
    compiled: ClassTable = request.getfixturevalue(f"{request.param}_table")
    return compiled
