"""The documentation: its links, commands and Python names exist, its examples and marked blocks run."""

from __future__ import annotations

import ast
import re
import shutil
import sys
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote

import pytest

import dappo_batch as package

from .command_line import dappo_batch
from .pages import FENCE, ROOT, blocks, name_of, run, run_line, shrunk

FRAME = {ROOT / "docs" / name for name in ("index.md", "api.md")}  # speak to the generator of the site alone
PAGES = [
    *(ROOT / name for name in ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "kernels/README.md")),
    *sorted(page for page in (ROOT / "docs").rglob("*.md") if page not in FRAME),
]
EXAMPLES = sorted((ROOT / "docs" / "examples").glob("*.py"))
DRIVER = ROOT / "docs" / "examples" / "drive_exported.py"  # a whole controller, which needs an export folder
NEEDS = {"sb3_vector_env.py": "stable_baselines3"}  # what an example needs beyond this package and its tests
SLOW = {
    "benchmark.py",
    "rendering.md",
    "report.md",
    "sweeps.md",
    "tutorial.md",
    "diagnose_log.py",
    "train_with_callback.py",
    "own_damage.py",
}

LINK = re.compile(r"\]\(([^)\s]+)\)|<img[^>]*\ssrc=\"([^\"]+)\"")
DOTTED = re.compile(r"\bdappo_batch(?:\.\w+)+")
IMPORTED = re.compile(r"^ *from (dappo_batch[\w.]*) import (?:\(([^)]*)\)|([\w, ]+))", re.MULTILINE)
CLASSES = "|".join(name for name in package.__all__ if isinstance(getattr(package, name), type))
MEMBER = re.compile(rf"(?<![\w.])(?:{CLASSES})\.[a-z_]\w*")
GONE = {"dappo_batch.gpu_check"}  # the changelog says where it went
COMMAND = re.compile(r"\bdappo-batch(?: ([a-z]\S*))?([^|\n;&]*)")


def marked(path: Path) -> object:
    """Return a page or an example as a parameter, with the mark of those that take long."""
    return pytest.param(path, marks=[pytest.mark.slow] if path.name in SLOW else [])


def prose(page: Path) -> str:
    """Return a page without code."""
    return re.sub(r"`[^`\n]*`", "", FENCE.sub("", page.read_text(encoding="utf-8")))


def anchors(page: Path) -> set[str]:
    """Return the anchors that code hosts give to the headings of a page."""
    headings = re.findall(r"^#+ (.*)$", FENCE.sub("", page.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def python_names(page: Path) -> set[str]:
    """Return every name of this package that a page or an example mentions in code."""
    text = page.read_text(encoding="utf-8")
    if page.suffix == ".md":
        code = [block.text for block in blocks(page) if block.language in ("python", "{eval-rst}")]
        rest = FENCE.sub("", text)
        text = "\n".join(
            [*code, *re.findall(r"^ {4}.*$", rest, re.MULTILINE), *re.findall(r"`([^`\n]+)`", rest)]
        )
    names = set(DOTTED.findall(text)) | {f"dappo_batch.{member}" for member in MEMBER.findall(text)}
    for module, in_brackets, in_line in IMPORTED.findall(text):
        names |= {f"{module}.{name}" for name in re.findall(r"\w+(?= *(?:,|$))", in_brackets or in_line)}
    return names - GONE


def exists(name: str) -> bool:
    """Return whether a dotted name is a module of the package, or in one."""
    parts = name.split(".")
    module, depth = package.__name__, 1
    while depth < len(parts) and source_of(f"{module}.{parts[depth]}"):
        module, depth = f"{module}.{parts[depth]}", depth + 1
    try:
        found: object = import_module(module)
    except ImportError:  # an extra is missing, so that its source has to do
        tree = ast.parse(Path(str(source_of(module))).read_text(encoding="utf-8"))
        return set(parts[depth : depth + 1]) <= {getattr(node, "name", "") for node in tree.body}
    for part in parts[depth:]:
        if not hasattr(found, part):
            # Attributes that instances alone have are described with their class.
            return isinstance(found, type) and bool(
                re.search(rf"^ *{part} ?[,:]", found.__doc__ or "", re.MULTILINE)
            )
        found = getattr(found, part)
    return True


def source_of(module: str) -> str | None:
    """Return the file of a module, if there is one."""
    try:
        spec = find_spec(module)
    except ImportError:  # its parent is no package, or lacks an extra
        return None
    return None if spec is None else spec.origin


@cache
def help_of(command: str) -> str:
    """Return what ``dappo-batch COMMAND --help`` prints; the list of commands for an empty name."""
    return dappo_batch(*command.split(), "--help")[0]


@pytest.fixture
def workplace(tmp_path: Path) -> Path:
    """Return a folder that looks like the repository, in which blocks may leave their runs."""
    for name in ("configs", "docs", "tests", "Makefile"):
        (tmp_path / name).symlink_to(ROOT / name)
    return tmp_path


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_relative_link_and_image_leads_to_a_file_and_a_heading(page: Path) -> None:
    for first, second in LINK.findall(prose(page)):
        target, _, anchor = (first or second).partition("#")
        if target.startswith(("http://", "https://", "mailto:")):
            continue
        path = page if not target else (page.parent / unquote(target)).resolve()
        assert path.exists(), f"{name_of(page)} links to {target}, which does not exist"
        assert path.is_relative_to(ROOT), f"{name_of(page)} links to {target}, outside the repository"
        if anchor:
            assert anchor in anchors(path), f"{name_of(page)} links to #{anchor}, no heading of {target}"


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_command_and_option_in_a_page_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    shell = "\n".join(block.text for block in blocks(page) if block.language == "sh")
    spans = "\n".join(re.findall(r"`([^`\n]+)`", FENCE.sub("", text)))
    for command, rest in COMMAND.findall(f"{shell}\n{spans}"):
        if command:
            known = re.findall(r"^  ([a-z]+) ", help_of(""), re.MULTILINE)
            assert command in known, f"no command {command}"
        # A command may have commands of its own, as `diagnose` has.
        inner = re.search(r"^ ([a-z]+)\b", rest)
        is_command = inner and re.search(rf"^  {inner[1]} +\w", help_of(command), re.MULTILINE)
        whole = f"{command} {inner[1]}" if inner and is_command else command
        for option in re.findall(r"(?<!\S)--[a-z][a-z-]*", rest):
            assert re.search(rf"{option}\b", help_of(whole)), f"dappo-batch {whole} has no {option}"


@pytest.mark.parametrize("page", [*PAGES, ROOT / "docs" / "api.md", *EXAMPLES], ids=name_of)
def test_every_python_name_in_a_page_exists(page: Path) -> None:
    missing = sorted(name for name in python_names(page) if not exists(name))
    assert not missing, f"{name_of(page)} mentions names that do not exist: {', '.join(missing)}"


@pytest.mark.parametrize(
    "text",
    [
        "Call `dappo_batch.teleport` first.",
        "`dappo_batch.sweeps.ray.RayExekutor` runs on a cluster.",
        "`Policy.lode(run)` reads it.",
        "```python\nfrom dappo_batch.render import Wolk\n```",
    ],
)
def test_an_invented_python_name_does_not_pass(text: str, tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(text, encoding="utf-8")
    assert [name for name in python_names(page) if not exists(name)]


@pytest.mark.skipif(shutil.which("make") is None, reason="make is not installed")
@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_make_job_in_a_page_exists(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    jobs = set(re.findall(r"^make ([a-z-]+)", text, re.MULTILINE)) | set(
        re.findall(r"`make ([a-z-]+)`", text)
    )
    for job in sorted(jobs):
        run(["make", "-n", job], ROOT)


@pytest.mark.parametrize(
    "page", [marked(page) for page in PAGES if any(block.runnable for block in blocks(page))], ids=name_of
)
def test_the_runnable_blocks_of_a_page_run_from_top_to_bottom(
    page: Path, workplace: Path, request: pytest.FixtureRequest
) -> None:
    if page.name == "rendering.md":
        request.getfixturevalue("opengl")
    for block in blocks(page):
        if block.file is not None:
            (workplace / block.file).write_text(block.text, encoding="utf-8")
        elif block.runnable and block.language == "python":
            run([sys.executable, "-c", block.text], workplace)
        elif block.runnable:
            assert block.language == "sh"
            for line in block.text.splitlines():
                if "docs/examples/" not in line:
                    run_line(shrunk(line), workplace)


@pytest.mark.parametrize("example", [marked(path) for path in EXAMPLES if path != DRIVER], ids=name_of)
def test_every_example_runs_and_prints_something(example: Path, tmp_path: Path) -> None:
    needed = NEEDS.get(example.name)
    if needed is not None and find_spec(needed) is None:
        pytest.skip(f"{needed} is not installed")
    assert run([sys.executable, str(example)], tmp_path).strip()


def test_examples_are_short_and_named_in_a_guide() -> None:
    pages = "".join(page.read_text(encoding="utf-8") for page in PAGES)
    for example in EXAMPLES:
        assert len(example.read_text(encoding="utf-8").splitlines()) < (195 if example == DRIVER else 60)
        assert f"python docs/examples/{example.name}" in pages


def test_the_two_main_commands_come_first_in_the_readme() -> None:
    first, second = [block.text.strip() for block in blocks(ROOT / "README.md")][:2]
    assert (first, second) == ("make train", "make test")
