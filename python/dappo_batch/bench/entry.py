"""Who takes part in a benchmark: what can be made here, and what cannot and why."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterable, Mapping
from typing import ClassVar, TypeVar

from dappo_batch.bench.contenders import Unavailable
from dappo_batch.bench.report import Missing

__all__ = ["Entrant", "absent", "enter"]

T = TypeVar("T")


class Entrant:
    """Something that may need packages beyond those of this project.

    Attributes
    ----------
    key : str
        Name in tables and JSON.
    about : str
        What it is.
    packages : dict
        What it needs beyond this package: name to import, name to install.
    note : str
        Remarks on this very run, such as the version that was measured.
    """

    key: ClassVar[str]
    about: ClassVar[str]
    packages: ClassVar[dict[str, str]] = {}
    note: str = ""

    @classmethod
    def require(cls) -> None:
        """Raise `Unavailable` if a package is missing."""
        lacking = [name for module, name in cls.packages.items() if importlib.util.find_spec(module) is None]
        if lacking:
            verb = "is" if len(lacking) == 1 else "are"
            names = " and ".join(lacking)
            raise Unavailable(f"{names} {verb} not installed", f"pip install {' '.join(lacking)}")

    def close(self) -> None:
        """Free processes and memory."""


def absent(kinds: Iterable[type[Entrant]]) -> list[Missing]:
    """Return those whose packages are not installed."""
    missing = []
    for kind in kinds:
        try:
            kind.require()
        except Unavailable as reason:
            missing.append(Missing(kind.key, str(reason), reason.install))
    return missing


def enter(
    makers: Mapping[str, Callable[[], T]], progress: Callable[[str], None]
) -> tuple[list[T], list[Missing]]:
    """Make everything that can run here, and say why the rest cannot.

    Parameters
    ----------
    makers : mapping
        From the key of a contender to what makes it or raises `Unavailable`.
    progress : callable
        Told what is made.
    """
    made: list[T] = []
    missing: list[Missing] = []
    for key, make in makers.items():
        progress(f"making {key}")
        try:
            made.append(make())
        except Unavailable as reason:
            missing.append(Missing(key, str(reason), reason.install))
    return made, missing
