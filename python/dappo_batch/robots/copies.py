"""Copies of a robot: all its files in one folder, and the differences of two versions of a robot.

Runs, datasets and diagnosers contain a copy of their robot, because it defines the meaning of a damage code.
Exports contain one so that they can be used anywhere.
"""

from __future__ import annotations

import dataclasses
import difflib
import hashlib
import json
import os
import re
import tempfile
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import mujoco
import numpy as np

from dappo_batch._core import CheckpointError, ConfigError, read_file
from dappo_batch.damage import default_options, make_damage_type
from dappo_batch.model.mujoco_library import MUJOCO_ERRORS, quiet_mujoco
from dappo_batch.robots import Robot, load_robot
from dappo_batch.robots.faults import raise_faults
from dappo_batch.robots.flatten import flatten, lines, needed_files
from dappo_batch.robots.mjcf import MOST_ASSET_BYTES, mjcf_faults, read_mjcf
from dappo_batch.terms import import_module

__all__ = ["COPY_TOML", "RobotCopy", "check_confined", "damage_settings", "explain"]

COPY_TOML = "robot.toml"
"""Name of the robot TOML in a copy."""

_FORMAT = "dappo-batch robot 1"
_MJCF, _HEADER = "robot.xml", "robot.json"
_HEADER_BYTES = 1 << 20
_SHOWN = 8  # differences, or lines of one, that a message lists
_WIDTH = 160  # characters of a value or line in a message
_MJCF_ENTRY = re.compile(r"""^[ \t]*(mjcf|"mjcf"|'mjcf')[ \t]*=.*$""", re.MULTILINE)


@dataclass(frozen=True)
class RobotCopy:
    """The files of a robot, and the settings of its damage.

    Attributes
    ----------
    origin : str
        Name of the copied robot, or path of its TOML.
    files : dict
        Contents by name: ``robot.toml``, ``robot.xml`` (the MJCF without includes) and other files.
    damage : dict
        Damage types in the order of the code, ``max_damaged_limbs``, ``severity``, and the parameters of each
        type.
    sources : dict
        SHA-256 of the content of the original MJCF files, by their path relative to the first one.
    assets : dict
        Original names of meshes and textures, by their names in the copy.
    """

    origin: str
    files: Mapping[str, bytes]
    damage: Mapping[str, Any]
    sources: Mapping[str, str]
    assets: Mapping[str, str]

    @classmethod
    def of(cls, robot: str | Path, damage: Mapping[str, Any]) -> RobotCopy:
        """Copy a robot.

        Parameters
        ----------
        robot : str or pathlib.Path
            Name of a robot, or path of a robot TOML.
        damage : mapping
            The section ``[damage]`` of the configuration.

        Raises
        ------
        ConfigError
            If a file is missing or cannot be copied.
        """
        loaded = load_robot(robot)
        raise_faults(f"robot {loaded.name}: the MJCF {loaded.mjcf_path}", mjcf_faults(loaded.mjcf_path))
        flattened = flatten(loaded.mjcf_path)
        files = {COPY_TOML: _with_mjcf(loaded).encode(), _MJCF: flattened.text.encode()}
        files |= {name: text.encode() for name, text in flattened.documents.items()}
        files |= {name: _read(path) for name, path in flattened.assets.items()}
        names = {name: path.name for name, path in flattened.assets.items()}
        return cls(str(robot), files, damage_settings(loaded, damage), flattened.sources, names)

    @classmethod
    def read(cls, folder: Path) -> RobotCopy | None:
        """Read the copy in a folder, and check it; None if the folder does not exist.

        Raises
        ------
        CheckpointError
            If a file is missing or has changed.
        """
        if not os.path.lexists(folder):
            return None
        if folder.is_symlink():
            raise _broken(folder, "it is a symbolic link, expected a folder")
        try:
            header = json.loads(_read_regular(folder / _HEADER, _HEADER_BYTES))
            if header["format"] != _FORMAT:
                raise _broken(folder / _HEADER, f"its format is {header['format']!r}, expected {_FORMAT!r}")
            _check_kinds(header)
            files = {name: _checked(folder, name, known) for name, known in header["files"].items()}
            if lacking := {COPY_TOML, _MJCF, *header["assets"]} - files.keys():
                raise _broken(folder / _HEADER, f"it does not list {min(lacking)!r}")
            check_confined(folder, files)
            return cls(header["origin"], files, header["damage"], header["sources"], header["assets"])
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError) as error:
            raise _broken(folder / _HEADER, f"it is truncated or foreign ({error})") from error

    def to_write(self) -> dict[str, bytes]:
        """Return the files of a folder for `read`, by name; the last one must be written last."""
        header = {
            "format": _FORMAT,
            "origin": self.origin,
            "damage": self.damage,
            "sources": self.sources,
            "assets": self.assets,
            "files": {
                name: {"bytes": len(content), "sha256": _sha256(content)}
                for name, content in self.files.items()
            },
        }
        return {**self.files, _HEADER: (json.dumps(header, indent=2) + "\n").encode()}

    def check(self) -> None:
        """Check that MuJoCo compiles the copy and the original to the same model.

        Raises
        ------
        ConfigError
            If it does not, as the MJCF needs something that cannot be copied.
        """
        original = load_robot(self.origin).mjcf_path
        with tempfile.TemporaryDirectory() as folder:
            for name, content in self.files.items():
                Path(folder, name).write_bytes(content)
            models = []
            for path in (original, Path(folder, _MJCF)):
                try:
                    with quiet_mujoco():
                        spec = read_mjcf(path)
                        spec.compiler.usethread = False
                        models.append(spec.compile())
                except MUJOCO_ERRORS as error:
                    raise ConfigError(f"the robot {self.origin} cannot be copied: {error}") from error
        if array := _first_difference(*models):
            raise ConfigError(
                f"the robot {self.origin} cannot be copied: {array} of the copy differs;"
                f" remove references from {original} that only MuJoCo can resolve"
            )

    def differences(self, other: RobotCopy, *, ignoring: tuple[str, ...] = ()) -> list[str]:
        """Describe the differences of another version of the robot.

        Parameters
        ----------
        other : RobotCopy
            The other version.
        ignoring : tuple of str
            Entries of the robot TOML to ignore; ``damage`` stands for all settings of the damage.

        Returns
        -------
        list of str
            One entry for each difference; empty if there are none.
        """
        entries = []
        ignored = {"mjcf", "damage", *ignoring}
        one, two = ({k: v for k, v in copy.spec.items() if k not in ignored} for copy in (self, other))
        entries += [f"{_name(self.origin)}: {change}" for change in _changes(one, two)]
        if "damage" not in ignoring:
            entries += self.damage_changes(other.damage)
        entries += self._mjcf_differences(other)
        for name in sorted(self.assets.keys() & other.assets.keys()):
            digests = [_sha256(copy.files[name]) for copy in (self, other)]
            if digests[0] != digests[1]:
                entries.append(f"{other.assets[name]}: SHA-256 {digests[0][:12]}… → {digests[1][:12]}…")
        return entries

    def damage_changes(self, settings: Mapping[str, Any]) -> list[str]:
        """Describe the differences of other settings of the damage; see `damage_settings`."""
        one, two = _completed(self.damage), _completed(settings)
        return [f"{_name(self.origin)}: {change}" for change in _changes(one, two, "damage")]

    @property
    def spec(self) -> dict[str, Any]:
        """The parsed robot TOML."""
        return tomllib.loads(self.files[COPY_TOML].decode())

    def _mjcf_differences(self, other: RobotCopy) -> list[str]:
        """Return the elements that differ, with the names of their files."""
        entries = []
        documents = [
            {name: lines(copy.files[name].decode()) for name, _ in _needs(copy.files) if name != COPY_TOML}
            for copy in (self, other)
        ]
        for name in sorted(documents[0].keys() | documents[1].keys()):
            one, two = (found.get(name, []) for found in documents)
            if one != two:
                changed = difflib.unified_diff(one, two, n=0, lineterm="")
                entries += [_cut(line) for line in changed if not line.startswith(("---", "+++", "@@"))]
        if not entries:
            return []
        names = self.sources.keys() | other.sources.keys()
        changed_files = sorted(name for name in names if self.sources.get(name) != other.sources.get(name))
        return [", ".join(changed_files or sorted(names)) + ":\n" + _shortened(entries, "    ")]


def explain(differences: list[str]) -> str:
    """Return differences as lines of a message."""
    return _shortened(differences, "  ")


def damage_settings(robot: Robot, section: Mapping[str, Any]) -> dict[str, Any]:
    """Return all settings that define the meaning of a robot's damage codes.

    Parameters
    ----------
    robot : Robot
        The robot.
    section : mapping
        The section ``[damage]`` of a configuration; the default of a missing entry is that of the robot TOML.
    """
    for module in (*robot.damage_modules, *section.get("modules", ())):
        import_module(module)
    types = list(section.get("types") or robot.damage_types)
    options = section.get("options", {})
    limit = section.get("max_damaged_limbs")
    settings: dict[str, Any] = {
        "types": types,
        "max_damaged_limbs": robot.max_damaged_limbs if limit is None else limit,
    }
    per_limb = robot.damages_per_limb(types, section.get("max_damages_per_limb"))
    if per_limb != 1:  # earlier versions did not have it
        settings["max_damages_per_limb"] = per_limb
    severity = section.get("severity", 1.0)
    if isinstance(severity, list):
        settings["severity"] = [float(bound) for bound in severity]
        settings["severity_levels"] = section.get("severity_levels", 4)
    else:
        settings["severity"] = float(severity)
    for name in types:
        kind = make_damage_type(name, robot.damage_options(name) | dict(options.get(name, {})))
        # mypy does not know that concrete types are dataclasses.
        settings[name] = dataclasses.asdict(cast("Any", kind))
    return settings


def _completed(settings: Mapping[str, Any]) -> dict[str, Any]:
    """Return settings of the damage with the parameters that they lack, as those of earlier versions do."""
    return {
        key: {**default_options(key), **value} if isinstance(value, Mapping) else value
        for key, value in settings.items()
    }


def _with_mjcf(robot: Robot) -> str:
    """Return the text of the robot TOML with the MJCF of the copy."""
    text = _MJCF_ENTRY.sub(f'mjcf = "{_MJCF}"', robot.toml_text, count=1)
    if tomllib.loads(text) != {**robot.spec, "mjcf": _MJCF}:
        raise ConfigError(
            f"{robot.path}: the entry mjcf cannot be found; write it on a separate line, as in"
            f' `mjcf = "{robot.spec["mjcf"]}"`'
        )
    return text


def _read(path: Path) -> bytes:
    try:
        return path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror or error}") from error


def check_confined(folder: Path, files: Mapping[str, bytes]) -> None:
    """Check that a copy, which may be from an untrusted source, refers only to its own files.

    Raises
    ------
    CheckpointError
        If it refers to another file.
    """
    try:
        for name, wanted in _needs(files):
            if foreign := sorted(wanted - files.keys()):
                raise _broken(folder / name, f"it needs {foreign[0]!r}, which is not a file of the copy")
    except (ValueError, KeyError, RecursionError) as error:
        raise _broken(folder, f"it is broken or foreign ({error})") from error


def _needs(files: Mapping[str, bytes]) -> Iterator[tuple[str, set[str]]]:
    """Yield the robot TOML of a copy and all its MJCFs, with the files to which each refers.

    MJCFs may have any file extension.

    Raises
    ------
    ValueError, KeyError, RecursionError
        If a file is invalid or missing.
    """
    robot = tomllib.loads(files[COPY_TOML].decode())
    if not isinstance(robot.get("name"), str):
        raise ValueError(f"{COPY_TOML} has no name of the robot")
    waiting = [str(robot.get("mjcf"))]
    yield COPY_TOML, set(waiting)
    seen: set[str] = set()
    while waiting:
        name = waiting.pop()
        if name not in seen:
            seen.add(name)
            wanted, documents = needed_files(files[name].decode())
            yield name, wanted
            waiting += sorted(documents)


def _check_kinds(header: dict[str, Any]) -> None:
    """Raise if the entries of a header have other types than those of `RobotCopy.to_write`."""
    for name, kind in (
        ("origin", str),
        ("files", dict),
        ("damage", dict),
        ("sources", dict),
        ("assets", dict),
    ):
        if not isinstance(header[name], kind):
            raise TypeError(f"{name} is {header[name]!r:.40}")
    for name in ("sources", "assets"):
        if not all(isinstance(value, str) for value in header[name].values()):
            raise TypeError(f"{name} contains something that is not a text")


def _checked(folder: Path, name: str, known: Mapping[str, Any]) -> bytes:
    if Path(name).name != name:
        raise _broken(folder / _HEADER, f"it lists {name!r}, expected the name of a file in the same folder")
    content = _read_regular(folder / name, min(known["bytes"], MOST_ASSET_BYTES))
    if _sha256(content) != known["sha256"]:
        raise _broken(folder / name, "it has changed since it was written")
    return content


def _read_regular(path: Path, most: int) -> bytes:
    """Read a file from an untrusted source."""
    try:
        return read_file(path, most)
    except OSError as error:
        raise _broken(path, f"it cannot be read ({error.strerror})") from error


def _broken(path: Path, why: str) -> CheckpointError:
    return CheckpointError(f"copy of a robot {path}: {why}")


def _sha256(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


def _name(origin: str) -> str:
    return Path(origin).name if origin.endswith(".toml") else f"{origin}.toml"


def _changes(one: Mapping[str, Any], two: Mapping[str, Any], where: str = "") -> Iterator[str]:
    """Compare tables entry by entry; arrays of tables, such as limbs, if they have equal lengths."""
    for key in [*one, *(key for key in two if key not in one)]:
        path = f"{where}.{key}" if where else key
        yield from _change(one.get(key), two.get(key), path)


def _change(one: Any, two: Any, path: str) -> Iterator[str]:  # noqa: ANN401 - TOML is untyped
    if isinstance(one, Mapping) and isinstance(two, Mapping):
        yield from _changes(one, two, path)
    elif _are_tables(one) and _are_tables(two) and len(one) == len(two):
        for index, (first, second) in enumerate(zip(one, two, strict=True)):
            yield from _change(first, second, f"{path}[{index}]")
    elif one != two:
        yield f"{path}: {_value(one)} → {_value(two)}"


def _are_tables(value: Any) -> bool:  # noqa: ANN401 - TOML is untyped
    return isinstance(value, list) and bool(value) and all(isinstance(entry, Mapping) for entry in value)


def _value(value: object) -> str:
    return "nothing" if value is None else _cut(json.dumps(value, ensure_ascii=False, default=str))


def _cut(text: str) -> str:
    return text if len(text) <= _WIDTH else f"{text[:_WIDTH]}…"


def _shortened(entries: list[str], indent: str) -> str:
    shown = [f"{indent}{entry}" for entry in entries[:_SHOWN]]
    if len(entries) > _SHOWN:
        shown.append(f"{indent}and {len(entries) - _SHOWN} more")
    return "\n".join(shown)


def _first_difference(one: mujoco.MjModel, other: mujoco.MjModel) -> str | None:
    """Return the name of an array that differs between two models, ignoring file paths."""
    for name in dir(one):
        value = getattr(one, name)
        counts = isinstance(value, np.ndarray) and "path" not in name and not name.startswith("_")
        if counts and not np.array_equal(value, getattr(other, name)):
            return name
    return None
