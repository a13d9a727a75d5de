"""Fixtures of comparisons with MuJoCo and between backends."""

from __future__ import annotations

import os

import pytest

from dappo_batch import ConfigError
from dappo_batch._core import gpu_device


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """Allow software Vulkan for ``device="gpu"``; skip the test with the reason where there is no device."""
    monkeypatch.setitem(os.environ, "DAPPO_GPU_SOFTWARE", "1")
    try:
        gpu_device()
    except ConfigError as error:
        pytest.skip(str(error))
