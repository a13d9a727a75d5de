"""The examples of the guide to other learners run."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

pytestmark = pytest.mark.interop

GUIDE = Path(__file__).resolve().parents[2] / "docs" / "guides" / "interop.md"
SECTIONS = dict(part.split("\n", 1) for part in GUIDE.read_text(encoding="utf-8").split("\n## ")[1:])
BLOCKS = {
    library: "\n".join(re.findall(r"```python\n(.*?)```", text, re.DOTALL))
    for library, text in SECTIONS.items()
    if "```python\n" in text
}


def test_every_library_that_is_used_from_python_has_a_block() -> None:
    assert set(BLOCKS) == {"Stable-Baselines3", "rsl_rl", "torchrl", "skrl"}


@pytest.mark.parametrize("library", BLOCKS)
def test_the_block_of_a_library_runs(library: str) -> None:
    text = BLOCKS[library].replace("1_000_000", "64")  # one update
    for module in re.findall(r"^(?:from|import) (\w+)", text, re.MULTILINE):
        pytest.importorskip(module)
    exec(compile(text, f"{GUIDE.name}: {library}", "exec"), {})
