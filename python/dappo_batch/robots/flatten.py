"""An MJCF and its includes as one text, and the files that it needs.

MuJoCo's writer is not used because it rounds numbers: attributes are kept as they are written.
"""

from __future__ import annotations

import hashlib
import os
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from dataclasses import dataclass, field
from os.path import relpath
from pathlib import Path

from dappo_batch._core import ConfigError

__all__ = ["flatten", "lines", "needed_files"]

_COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
_FILES = re.compile(r"file|file(right|left|up|down|front|back)")
_DIRECTORIES = ("meshdir", "texturedir", "assetdir", "strippath")
_NAMED_AFTER_FILE = ("mesh", "hfield", "texture", "skin")


@dataclass
class Flattened:
    """An MJCF without includes, with all other files in the same folder.

    Attributes
    ----------
    text : str
        The MJCF.
    documents : dict
        Texts of the attached models, by file name.
    assets : dict
        Meshes, textures and height fields by file name.
    sources : dict
        SHA-256 of the content of every MJCF file, by its path relative to the first one.
    """

    text: str = ""
    documents: dict[str, str] = field(default_factory=dict)
    assets: dict[str, Path] = field(default_factory=dict)
    sources: dict[str, str] = field(default_factory=dict)


def flatten(path: Path) -> Flattened:
    """Read an MJCF and its includes.

    Parameters
    ----------
    path : pathlib.Path
        The MJCF file.

    Raises
    ------
    ConfigError
        If a file is missing, or is not XML.
    """
    flattened = Flattened()
    try:
        flattened.text = _Document(path, flattened, path.parent).text()
    except RecursionError:
        raise ConfigError(f"{path} includes or attaches itself, or is nested too deeply") from None
    return flattened


def needed_files(text: str) -> tuple[set[str], set[str]]:
    """Return the files of an MJCF, in its folder if it is flattened, and those of them that are MJCFs.

    Raises
    ------
    ValueError
        If it is not an MJCF.
    """
    found, documents = set(), set()
    model = _parse(text)
    # MuJoCo also reads other formats, whose references to files differ.
    if model.tag not in ("mujoco", "mujocoinclude"):
        raise ValueError(f"it begins with <{model.tag}>, expected <mujoco>")
    for element in model.iter():
        for name, value in element.items():
            if _FILES.fullmatch(name) or name in _DIRECTORIES:
                found.add(value)
        if element.tag in ("include", "model"):
            documents.add(element.get("file", ""))
    return found | documents, documents


def _parse(text: str) -> ET.Element:
    """Parse an MJCF like MuJoCo, which allows more in comments than XML.

    Comments are emptied and not removed: within an attribute, where MuJoCo has no comments, the rest is an
    error.
    """
    if "<![CDATA[" in text or "<!DOCTYPE" in text:
        raise ValueError("it has a CDATA section or a document type, which no MJCF needs")
    try:
        return ET.fromstring(_COMMENT.sub("<!---->", text))
    except ET.ParseError as error:
        raise ValueError(f"not valid XML: {error}") from error


def lines(text: str) -> list[str]:
    """Return the elements of an MJCF, one in each line, independent of layout and order of attributes."""
    return list(_lines(_parse(text)))


def _lines(element: ET.Element, indent: str = "") -> Iterator[str]:
    attributes = "".join(f' {name}="{" ".join(value.split())}"' for name, value in sorted(element.items()))
    yield f"{indent}<{element.tag}{attributes}>"
    for child in element:
        yield from _lines(child, f"{indent}  ")


class _Document:
    """A model in a file and its includes."""

    def __init__(self, path: Path, into: Flattened, root: Path) -> None:
        self._path, self._into, self._root = path, into, root
        # Elements with the folder of their file.
        self._elements: list[tuple[ET.Element, Path]] = []
        self._model = self._read(path)
        if self._model.tag != "mujoco":
            raise ConfigError(f"{path} is not an MJCF: it begins with <{self._model.tag}>, expected <mujoco>")
        self._include(self._model, path)
        self._directories = self._take_directories()

    def text(self) -> str:
        """Return the MJCF, with all files in its folder."""
        for element, origin in self._elements:
            for name, value in list(element.items()):
                if _FILES.fullmatch(name):
                    element.set(name, self._place(element, value, origin))
        ET.indent(self._model)
        return ET.tostring(self._model, encoding="unicode") + "\n"

    def _read(self, path: Path) -> ET.Element:
        try:
            element = _parse(path.read_text(encoding="utf-8-sig"))
        except OSError as error:
            raise ConfigError(f"{path} cannot be read: {error.strerror or error}") from error
        except ValueError as error:
            raise ConfigError(f"{path} cannot be read: {error}") from error
        content = "\n".join(_lines(element))
        self._into.sources[relpath(path, self._root)] = hashlib.sha256(content.encode()).hexdigest()
        return element

    def _include(self, parent: ET.Element, origin: Path) -> None:
        """Replace includes by the elements of the included files."""
        self._elements.append((parent, origin.parent))
        children: list[ET.Element] = []
        for child in parent:
            if child.tag == "include":
                path = self._find(child.get("file", ""), "", origin.parent, "include")
                included = self._read(path)
                self._include(included, path)
                children += included
            else:
                self._include(child, origin)
                children.append(child)
        parent[:] = children

    def _take_directories(self) -> dict[str, str]:
        """Remove the folders of meshes and textures from the compiler's settings and return the last ones."""
        found: dict[str, str] = {}
        for compiler in self._model.iter("compiler"):
            settings = {name: compiler.attrib.pop(name) for name in _DIRECTORIES if name in compiler.attrib}
            if "assetdir" in settings:
                found |= dict.fromkeys(("meshdir", "texturedir"), settings["assetdir"])
            found |= settings
        return found

    def _place(self, element: ET.Element, value: str, origin: Path) -> str:
        """Return the new name of a file."""
        if element.tag == "model":
            return self._attached(element, self._find(value, "", origin, "model"))
        if element.tag in _NAMED_AFTER_FILE and "file" in element.attrib:
            element.attrib.setdefault("name", Path(value).stem)
        if self._directories.get("strippath") == "true":
            value = Path(value).name
        directory = self._directories.get("texturedir" if element.tag == "texture" else "meshdir", "")
        path = self._find(value, directory, origin, element.tag)
        return self._name(path, self._into.assets)

    def _attached(self, element: ET.Element, path: Path) -> str:
        document = _Document(path, self._into, self._root)
        name = self._name(path, {})
        self._into.documents[name] = document.text()
        if "name" not in element.attrib and (model := document.name):
            element.set("name", model)
        return name

    @property
    def name(self) -> str | None:
        """Name of the model."""
        return self._model.get("model")

    def _name(self, path: Path, known: dict[str, Path]) -> str:
        """Return a unique name for a file, the same in every call."""
        plain = re.sub(r"[^A-Za-z0-9._-]", "_", path.name)
        number = 0
        while True:
            name = f"robot-{number}-{plain}" if number else f"robot-{plain}"
            if name not in self._into.documents and known.setdefault(name, path) == path:
                return name
            number += 1

    def _find(self, value: str, directory: str, origin: Path, tag: str) -> Path:
        """Return the path of a file, in the folder of assets or in the folder of the referring file."""
        places = [Path(os.path.realpath(at / value)) for at in (self._path.parent / directory, origin)]
        for place in places:
            if os.path.isfile(place):
                return place
        looked = " and ".join(map(str, dict.fromkeys(places)))
        raise ConfigError(f"{self._path}: the file {value!r} of a <{tag}> is missing: looked for {looked}")
