"""Checks of the files of an MJCF before MuJoCo reads them.

MuJoCo has no limits: it blocks on a pipe, creates a hundred million copies of a body, and may crash on a
height field whose size overflows its integers. The text is therefore checked first, in time and memory that
are bounded by its length.
"""

from __future__ import annotations

import math
import os
import stat
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING
from xml.parsers import expat

import mujoco

from dappo_batch.robots.flatten import needed_files

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

__all__ = ["mjcf_faults", "read_mjcf"]

_MOST_BYTES = 32 << 20
"""Limit of all XML files together."""
MOST_ASSET_BYTES = 1 << 30
_MOST_FILES = 256
_MOST_ELEMENTS = 100_000
"""Limit of elements, including copies by ``replicate`` and similar elements."""
_DEEPEST = 200
_MOST_MEMORY = 4 << 30

# Limit of the product of these attributes, the length of an array that MuJoCo allocates.
_SIZES: dict[str, tuple[tuple[str, ...], int]] = {
    "hfield": (("nrow", "ncol"), 4_000_000),
    "texture": (("width", "height"), 1 << 26),
    "user": (("dim",), 100_000),
    "contact": (("num",), 10_000),
}
# Limit of ``nsample`` of every element.
_MOST_SAMPLES = 10_000
# Limits of attributes of <size>: numbers for each element of a kind, and numbers of a model.
_MOST_USER_NUMBERS = 1_000
_MOST_OF_A_SIZE = 10_000_000
_COPYING = ("replicate", "composite", "flexcomp")
_UNITS = {"K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40, "P": 1 << 50, "E": 1 << 60}


@dataclass
class _Scan:
    """Findings in the files of one MJCF."""

    main: Path
    faults: list[str] = field(default_factory=list)
    folders: set[Path] = field(default_factory=set)
    """Folders of assets, relative to the folder of a file."""
    files: list[Path] = field(default_factory=list)
    assets: set[tuple[Path, str]] = field(default_factory=set)
    elements: int = 0
    size: int = 0

    def fault(self, path: Path, what: str) -> None:
        self.faults.append(f"{path.name}: {what}")


def read_mjcf(path: Path) -> mujoco.MjSpec:
    """Read an MJCF with MuJoCo.

    MuJoCo opens only paths in UTF-8. For other paths it receives the text and the files in the same folder to
    which the text refers, which are all files of the copy of a robot.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        text = path.read_text(encoding="utf-8")
        beside = {name: path.parent / name for name in needed_files(text)[0]}
        others = {name: file.read_bytes() for name, file in beside.items() if file.is_file()}
        return mujoco.MjSpec.from_string(text, assets=others)
    return mujoco.MjSpec.from_file(str(path))


def mjcf_faults(path: Path) -> list[str]:
    """Return the reasons why MuJoCo cannot read an MJCF and its files in bounded time and memory.

    Parameters
    ----------
    path : pathlib.Path
        The MJCF.

    Returns
    -------
    list of str
        One sentence for each fault; empty if MuJoCo may read the file. It need not be a valid robot.
    """
    scan = _Scan(path, folders={Path()})
    _scan_file(scan, path)
    for folder, name in sorted(scan.assets):
        for candidate in {base / sub / name for base in (folder, path.parent) for sub in scan.folders}:
            if (what := _unreadable(candidate, MOST_ASSET_BYTES)) is not None:
                scan.fault(path, f"the file {name!r} {what}")
    if scan.elements > _MOST_ELEMENTS:
        scan.fault(
            path, f"it has {scan.elements:.3g} elements with all copies, the limit is {_MOST_ELEMENTS}"
        )
    return list(dict.fromkeys(scan.faults))


def _unreadable(path: Path, most: int) -> str | None:
    """Return why an existing file must not be read; None also for a missing one, which MuJoCo reports."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    if not stat.S_ISREG(found.st_mode):
        return "is not a regular file"
    if found.st_size > most:
        return f"has {found.st_size} bytes, the limit is {most}"
    return None


def _scan_file(scan: _Scan, path: Path) -> None:
    if path in scan.files:
        return  # MuJoCo reports a file that includes itself
    scan.files.append(path)
    if len(scan.files) > _MOST_FILES:
        scan.fault(scan.main, f"it includes more than {_MOST_FILES} files")
        return
    what = _unreadable(path, _MOST_BYTES)
    if what is not None:
        scan.fault(scan.main, f"the file {str(path)!r} {what}")
        return
    try:
        data = path.read_bytes()
    except OSError:
        return  # MuJoCo reports the missing file
    scan.size += len(data)
    if scan.size > _MOST_BYTES:
        scan.fault(scan.main, f"its files have more than {_MOST_BYTES} bytes")
        return
    try:
        _Reader(scan, path).read(data)
    except expat.ExpatError as error:
        scan.fault(path, f"it is not well-formed XML: {error}")


class _Reader:
    """Scans the elements of one file."""

    def __init__(self, scan: _Scan, path: Path) -> None:
        self.scan = scan
        self.path = path
        self.copies = [1]
        self.includes: list[Path] = []

    def read(self, data: bytes) -> None:
        parser = expat.ParserCreate()
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.EntityDeclHandler = self._entity
        parser.StartCdataSectionHandler = self._cdata
        parser.Parse(_without_comments(data), True)
        for include in self.includes:
            _scan_file(self.scan, include)

    def _entity(self, *_: object) -> None:
        self.scan.fault(self.path, "it declares an entity, which MuJoCo does not support")

    def _cdata(self) -> None:
        self.scan.fault(self.path, "it has a CDATA section, which no MJCF needs")

    def _end(self, _: str) -> None:
        self.copies.pop()

    def _start(self, name: str, attributes: Mapping[str, str]) -> None:
        copies = self.copies[-1]
        if name in _COPYING:
            copies *= max(1, math.prod(_numbers(attributes.get("count", "1")).values()))
        self.copies.append(min(copies, 1 << 60))
        self.scan.elements += min(copies, 1 << 60)
        if len(self.copies) == _DEEPEST + 1:
            self.scan.fault(self.path, f"its elements are nested more than {_DEEPEST} deep")
        _check_sizes(name, attributes, lambda what: self.scan.fault(self.path, f"<{name}>: {what}"))
        folder = self.path.parent
        if name == "compiler":
            self.scan.folders |= {
                Path(attributes[key]) for key in ("meshdir", "texturedir", "assetdir") if key in attributes
            }
        for key, value in attributes.items():
            if not key.startswith("file"):
                continue
            if name in ("include", "model"):
                # Relative to the file itself or to the first one, depending on the version.
                places = dict.fromkeys((folder / value, self.scan.main.parent / value))
                self.includes += [place for place in places if os.path.exists(place)]
            else:
                self.scan.assets.add((folder, value))


def _without_comments(data: bytes) -> bytes:
    """Blank comments, which may contain hyphens in MuJoCo but not in XML, and keep line numbers."""
    parts, position = [], 0
    while (start := data.find(b"<!--", position)) >= 0:
        end = data.find(b"-->", start + 4)
        if end < 0:
            break  # the parser reports it
        # An empty comment is left, which is an error within an attribute, where MuJoCo has no comments.
        parts += [data[position:start], b"<!--", b"\n" * data.count(b"\n", start, end), b"-->"]
        position = end + 3
    return b"".join([*parts, data[position:]])


def _check_sizes(name: str, attributes: Mapping[str, str], fault: Callable[[str], None]) -> None:
    keys, most = _SIZES.get(name, ((), 0))
    numbers = [next(iter(_numbers(attributes[key]).values()), 1) for key in keys if key in attributes]
    if any(number < 0 for number in numbers) or math.prod(numbers) > most > 0:
        fault(f"{' times '.join(keys)} is {' x '.join(map(str, numbers))}, expected at most {most}")
    samples = _numbers(attributes.get("nsample", "0")).get(0, 0)
    if samples > _MOST_SAMPLES:
        fault(f"nsample is {samples}, expected at most {_MOST_SAMPLES}")
    if name != "size":
        return
    for key, value in attributes.items():
        limit = _MOST_USER_NUMBERS if key.startswith("nuser_") else _MOST_OF_A_SIZE
        if key == "memory":
            limit = _MOST_MEMORY
        if _numbers(value).get(0, 0) > limit:
            fault(f"{key} is {value}, expected at most {limit}")


def _numbers(text: str) -> dict[int, int]:
    """Return the whole numbers of an attribute by their place; a unit such as K multiplies one."""
    found: dict[int, int] = {}
    for index, word in enumerate(text.split()[:8]):
        unit = _UNITS.get(word[-1:].upper(), 1)
        digits = word if unit == 1 else word[:-1]
        try:
            number = float(digits) * unit
        except ValueError:
            continue
        found[index] = int(number) if math.isfinite(number) else 1 << 60
    return found
