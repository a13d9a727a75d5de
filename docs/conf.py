"""The documentation as a site: ``make docs`` writes it to ``site``."""

from __future__ import annotations

import importlib.metadata
import re
import tomllib
from pathlib import Path
from typing import TYPE_CHECKING

from docutils import nodes
from sphinx.addnodes import download_reference, pending_xref

if TYPE_CHECKING:
    from sphinx.application import Sphinx

ROOT = Path(__file__).resolve().parents[1]
CARGO = tomllib.loads((ROOT / "Cargo.toml").read_text())
REPOSITORY = f"{CARGO['workspace']['package']['repository']}/blob/main"

project = "dappo-batch"
copyright = "the authors of dappo-batch"
release = importlib.metadata.version("dappo-batch")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
html_theme = "furo"
html_title = "dappo-batch"
html_static_path = ["site.css"]
html_css_files = ["site.css"]
myst_heading_anchors = 4
myst_enable_extensions = ["dollarmath"]
napoleon_google_docstring = False
napoleon_use_rtype = False
napoleon_use_ivar = True
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_type_aliases = {"ArrayLike": "ArrayLike"}  # not all that it stands for
# Third-party programs behind the adaptors and executors: large, and not needed to describe these.
autodoc_mock_imports = ["ray", "rsl_rl", "stable_baselines3", "submitit", "tensordict", "torch"]
# Fences of the guides contain whether tests run them, which is unknown to the highlighter.
suppress_warnings = ["misc.highlighting_failure"]


def to_the_repository(app: Sphinx, tree: nodes.document) -> None:
    """Resolve links to files outside the site to the repository."""
    env = app.env
    page = Path(env.doc2path(env.current_document.docname))
    for node in [*tree.findall(pending_xref), *tree.findall(download_reference)]:
        target, _, anchor = node["reftarget"].partition("#")
        # The README, which is part of the first page, is in the root.
        places = [place / f"{target}{end}" for place in (page.parent, ROOT) for end in ("", ".md")]
        path = next((place.resolve() for place in places if target and place.exists()), None)
        if path is None or env.path2doc(path) in env.found_docs:
            continue
        address = f"{REPOSITORY}/{path.relative_to(ROOT)}" + (f"#{anchor}" if anchor else "")
        node.replace_self(nodes.reference("", "", *node.children, refuri=address, internal=False))


def join_attributes(
    app: Sphinx, what: str, name: str, item: object, options: object, lines: list[str]
) -> None:
    """Write attributes that share a description as `a/b`: of `a, b` Sphinx would take `a,` for a type."""
    start = lines.index("Attributes") if "Attributes" in lines else len(lines)
    for row in range(start, len(lines)):
        if re.match(r"\w+(, \w+)+ : ", lines[row]):
            names, kind = lines[row].split(" : ", 1)
            lines[row] = f"{names.replace(', ', '/')} : {kind}"


def shorten_aliases(
    app: Sphinx,
    what: str,
    name: str,
    item: object,
    options: object,
    arguments: str | None,
    returns: str | None,
) -> tuple[str | None, str | None]:
    """Write the names of aliases, where Sphinx would write how it refers to them."""
    short = (text and re.sub(r"TypeAliasForwardRef\('(\w+)'\)", r"\1", text) for text in (arguments, returns))
    return next(short), next(short)


def setup(app: Sphinx) -> None:
    """Connect the handlers: before Sphinx copies the files that can be downloaded, and before napoleon."""
    app.connect("doctree-read", to_the_repository, priority=100)
    app.connect("autodoc-process-docstring", join_attributes, priority=100)
    app.connect("autodoc-process-signature", shorten_aliases)
