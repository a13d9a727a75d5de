"""Extras: packages that only some features need."""

from __future__ import annotations

import importlib.util

from dappo_batch._core import DappoError

__all__ = ["MissingExtraError", "install", "lacking", "missing", "require"]

_PACKAGES = {
    "ray": {"ray": "ray"},
    "report": {"matplotlib": "matplotlib"},
    "slurm": {"submitit": "submitit"},
    "video": {"PIL": "pillow", "av": "av"},
    "viewer": {"mjviser": "mjviser"},
}
"""Package names by module name, for each extra."""


class MissingExtraError(DappoError, ImportError):
    """A feature needs an extra that is not installed; the message contains the install command."""


def install(extra: str) -> str:
    """Return the command that installs an extra."""
    return f"pip install 'dappo-batch[{extra}]'"


def lacking(extra: str) -> list[str]:
    """Return the packages of an extra that are not installed."""
    return [name for module, name in _PACKAGES[extra].items() if importlib.util.find_spec(module) is None]


def missing(extra: str, packages: list[str], what: str) -> MissingExtraError:
    """Return the error for packages that are not installed and are needed by `what`, a plural."""
    verb = "is" if len(packages) == 1 else "are"
    return MissingExtraError(
        f"{' and '.join(packages)} {verb} not installed, which {what} need: {install(extra)}"
    )


def require(extra: str, what: str) -> None:
    """Check that an extra is installed.

    Raises
    ------
    MissingExtraError
        If it is not installed.
    """
    if packages := lacking(extra):
        raise missing(extra, packages, what)
