"""Some inputs of each kind of the fuzzer end in a result or a typed error."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from .fuzz.outcome import Output, attempt
from .fuzz.room import Room
from .fuzz.targets import TARGETS

# Roughly equal times.
EXAMPLES = {"robot": 40, "table": 30, "environment": 60, "functions": 20, "command_line": 60, "report": 2}
EXAMPLES |= {
    "run_folder": 60,
    "diagnoser_folder": 60,
    "dataset": 40,
    "export_folder": 60,
    "single_env": 60,
    "settings": 60,
    "configuration": 60,
    "sweep": 8,
}


@pytest.fixture
def room(valid_files: Path, tmp_path: Path) -> Iterator[Room]:
    """Return the temporary folder of a test."""
    before = Path.cwd()
    yield Room(valid_files, tmp_path / "rooms")
    os.chdir(before)


@pytest.mark.parametrize("target", TARGETS)
def test_an_odd_input_ends_in_a_result_or_a_typed_error(target: str, room: Room, tmp_path: Path) -> None:
    output = Output(tmp_path / "output")
    seen = []

    @settings(max_examples=EXAMPLES.get(target, 200))
    @given(st.integers(0, 10**9))
    def check(case: int) -> None:
        with warnings.catch_warnings(), output.caught():
            warnings.simplefilter("ignore")
            accepted, fault = attempt(target, f"property-{case}", room, output)
            room.clear()
        seen.append(accepted)
        assert fault is None, f"{fault.signature}\n{fault.detail}"

    check()
    if len(seen) > 20:
        # Inputs that are all refused at the first look would show little, and so would valid ones.
        assert any(seen)
        assert not all(seen)
