"""The wheels with public robots."""

from __future__ import annotations

from pathlib import Path

import pytest

from .vendors import NoWheelsError, install_wheels


@pytest.fixture(scope="session")
def wheels() -> Path:
    """Return the folder of the unpacked wheels, or skip the test."""
    try:
        return install_wheels()
    except NoWheelsError as error:
        pytest.skip(f"no wheels with public robots: {error}")
