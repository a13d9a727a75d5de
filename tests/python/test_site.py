"""The documentation as a site: it is built without a warning, and holds every page and every name."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

import dappo_batch
import dappo_batch.render

from .. import processes

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Build the site as `make docs` does."""
    folder = tmp_path_factory.mktemp("site")
    builder = (sys.executable, "-m", "sphinx", "--quiet", "--fail-on-warning", "--keep-going")
    done = processes.run([*builder, ROOT / "docs", folder], timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return folder


def test_every_page_is_on_the_site_and_reachable_from_its_first(site: Path) -> None:
    pages = {page.relative_to(ROOT / "docs").with_suffix("") for page in (ROOT / "docs").rglob("*.md")}
    first = (site / "index.html").read_text(encoding="utf-8")
    for page in pages - {Path("index")}:
        assert (site / page).with_suffix(".html").is_file(), page
        assert f'href="{page}.html"' in first, page


def test_the_reference_describes_everything_that_is_offered(site: Path) -> None:
    reference = (site / "api.html").read_text(encoding="utf-8")
    undescribed = {name for name in dappo_batch.__all__ if f'id="dappo_batch.{name}"' not in reference}
    assert undescribed == {"__version__"}


def test_the_reference_describes_every_public_module(site: Path) -> None:
    reference = (site / "api.html").read_text(encoding="utf-8")
    for module in (
        "damage",
        "model",
        "render",
        "report",
        "sweeps.ray",
        "sweeps.slurm",
        "interop.sb3",
        "interop.rsl_rl",
    ):
        assert f'id="module-dappo_batch.{module}"' in reference, module
    undescribed = {
        name for name in dappo_batch.render.__all__ if f'id="dappo_batch.render.{name}"' not in reference
    }
    assert undescribed == {"RenderError"}  # it is in `dappo_batch`
    for name in (
        "damage.MissingShank",
        "report.write",
        "sweeps.Cell",
        "sweeps.ray.RayExecutor",
        "interop.sb3.Sb3VecEnv",
    ):
        assert f'id="dappo_batch.{name}"' in reference, name


def test_what_is_not_on_the_site_is_linked_in_the_repository(site: Path) -> None:
    first = (site / "index.html").read_text(encoding="utf-8")
    assert 'blob/main/CONTRIBUTING.md"' in first
    assert 'href="CONTRIBUTING' not in first
