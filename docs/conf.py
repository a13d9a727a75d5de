"""The documentation as a site: ``make docs`` writes it to ``site``."""

from __future__ import annotations

import importlib.metadata
from pathlib import Path
from typing import TYPE_CHECKING

from docutils import nodes

if TYPE_CHECKING:
    from sphinx.addnodes import pending_xref
    from sphinx.application import Sphinx
    from sphinx.environment import BuildEnvironment

ROOT = Path(__file__).resolve().parents[1]
REPOSITORY = "https://github.com/dappo-batch/dappo-batch/blob/main"

project = "dappo-batch"
copyright = "the authors of dappo-batch"  # noqa: A001 - Sphinx's name
release = importlib.metadata.version("dappo-batch")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = "dappo-batch"
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
napoleon_google_docstring = False
napoleon_use_rtype = False
autodoc_member_order = "bysource"
autodoc_typehints = "description"
# Fences of the guides say whether tests run them, which a highlighter need not know.
suppress_warnings = ["misc.highlighting_failure"]


def to_the_repository(
    app: Sphinx, env: BuildEnvironment, node: pending_xref, text: nodes.TextElement
) -> nodes.reference | None:
    """Let links to files outside of the site lead to the repository."""
    if node.get("reftype") != "myst":
        return None
    page = Path(env.doc2path(node["refdoc"]))
    target, _, anchor = node["reftarget"].partition("#")
    path = (page.parent / target).resolve()
    if not (target and path.exists() and path.is_relative_to(ROOT)):
        return None
    address = f"{REPOSITORY}/{path.relative_to(ROOT)}" + (f"#{anchor}" if anchor else "")
    return nodes.reference("", "", *text.children, refuri=address, internal=False)


def setup(app: Sphinx) -> None:
    """Connect what this site does by itself."""
    app.connect("missing-reference", to_the_repository)
