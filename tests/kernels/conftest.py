"""Warp without its banner, on the CPU: the kernels that a GPU would run."""

from __future__ import annotations

from collections.abc import Iterator

import pytest


@pytest.fixture(autouse=True, scope="session")
def _quiet_cpu() -> Iterator[None]:
    wp = pytest.importorskip("warp")
    wp.config.log_level = wp.LOG_WARNING
    with wp.ScopedDevice("cpu"):
        yield
