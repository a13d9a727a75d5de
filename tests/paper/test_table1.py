"""The paper's Table 1, with which the diagnoser's sweep compares its results."""

from __future__ import annotations

from pathlib import Path

ORACLE = Path(__file__).parent / "paper_table1.csv"
SOURCE = Path(__file__).parents[2] / "rust/dappo-diagnose/src/sweep/paper_table1.csv"


def test_the_program_holds_the_papers_numbers() -> None:
    assert SOURCE.read_text() == ORACLE.read_text()
    assert len(SOURCE.read_text().splitlines()) == 1 + 36
