"""Compiled robots shared by all tests."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator

import pytest

import dappo_batch
from dappo_batch import ClassTable


@pytest.fixture(autouse=True, scope="session")
def _warp_on_one_device() -> Iterator[None]:
    """Let Warp, where a test has imported it, use one device, and keep quiet.

    It is the CPU, which runs what a GPU would, unless ``DAPPO_WARP_DEVICE`` names another one, as ``cuda:0``.
    """
    if "warp" not in sys.modules:
        yield
        return
    wp = sys.modules["warp"]
    wp.config.log_level = wp.LOG_WARNING
    with wp.ScopedDevice(os.environ.get("DAPPO_WARP_DEVICE", "cpu")):
        yield


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
