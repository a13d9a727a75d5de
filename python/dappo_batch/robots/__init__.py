"""Robots: an MJCF file and a robot TOML each, without any code.

A robot is added by putting ``<name>.xml`` and ``<name>.toml`` into this folder, or by giving the path of a
robot TOML anywhere on disk wherever a robot's name is asked for.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from dappo_batch._core import ConfigError

__all__ = ["DEFAULT_ROBOT", "ROBOTS", "Limb", "Robot", "built_in_config", "load_robot"]

_FOLDER = Path(__file__).resolve().parent

ROBOTS: tuple[str, ...] = tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))
"""Names of the robots that come with the package."""

DEFAULT_ROBOT = "ant"
"""The robot that commands use when none is named."""

_CONFIGS = _FOLDER.parent / "configs"


@dataclass(frozen=True)
class Limb:
    """One limb of a robot: a body and everything below it.

    Attributes
    ----------
    name : str
        Name for people.
    body : str
        Root body of the limb in the MJCF.
    joints : tuple of str
        Joints from the torso outwards.
    toe_geom : str
        Geom of the lowest segment, which the damage type ``missing_toe`` shortens.
    touch : str or None
        Touch sensor of the limb.
    touch_site : str or None
        Site of the touch sensor; it is shortened together with the toe.
    """

    name: str
    body: str
    joints: tuple[str, ...]
    toe_geom: str
    touch: str | None = None
    touch_site: str | None = None


@dataclass(frozen=True)
class Robot:
    """A robot TOML that was read and checked.

    Attributes
    ----------
    name : str
        Name of the robot.
    toml_text : str
        The robot TOML as it stands in the file.
    path : pathlib.Path
        Where the robot TOML lies.
    spec : dict
        The parsed robot TOML.
    """

    name: str
    toml_text: str
    path: Path
    spec: dict[str, Any]

    @property
    def mjcf_path(self) -> Path:
        """Path of the robot's MJCF file."""
        return self.path.parent / str(self.spec["mjcf"])

    @property
    def main_body(self) -> str:
        """Body whose x position gives the forward velocity."""
        return str(self.spec["main_body"])

    @cached_property
    def limbs(self) -> tuple[Limb, ...]:
        """Limbs in ring order."""
        return tuple(_limb(entry, index, self.path) for index, entry in enumerate(self.spec["limbs"]))

    @property
    def damage_types(self) -> tuple[str, ...]:
        """Names of the damage types, in the order in which damage classes are enumerated."""
        return tuple(self.spec["damage"]["types"])

    @property
    def max_damaged_limbs(self) -> int:
        """Largest number of limbs that are damaged at once."""
        return int(self.spec["damage"]["max_damaged_limbs"])

    def damage_options(self, damage_type: str) -> dict[str, Any]:
        """Return the parameters of a damage type, a copy of the table ``[damage.<damage_type>]``."""
        return dict(self.spec["damage"].get(damage_type, {}))


def built_in_config(robot: str | None = None) -> tuple[str, str] | None:
    """Read the training configuration that comes with a robot.

    Parameters
    ----------
    robot : str, optional
        Name of the robot, by default `DEFAULT_ROBOT`.

    Returns
    -------
    tuple of str or None
        File name and TOML text; None for a robot that comes without one.
    """
    path = _CONFIGS / f"{robot or DEFAULT_ROBOT}.toml"
    if robot is not None and robot not in ROBOTS:
        return None
    return (f"configs/{path.name}", path.read_text(encoding="utf-8")) if path.is_file() else None


def load_robot(name_or_path: str | Path) -> Robot:
    """Read a robot by its name or by the path of its robot TOML.

    Parameters
    ----------
    name_or_path : str or pathlib.Path
        One of `ROBOTS`, or a path to a file that ends in ``.toml``.

    Returns
    -------
    Robot
        The robot. Its MJCF has not been compiled yet.

    Raises
    ------
    ConfigError
        If the robot is unknown, or its TOML cannot be read or lacks an entry.
    """
    if isinstance(name_or_path, str) and name_or_path in ROBOTS:
        path = _FOLDER / f"{name_or_path}.toml"
    else:
        path = Path(name_or_path)
        if path.suffix != ".toml":
            raise ConfigError(
                f"unknown robot {str(name_or_path)!r}: expected one of {', '.join(ROBOTS)}, or the path of a"
                " robot TOML (a file that ends in .toml and names an MJCF; copy robots/ant.toml to write one)"
            )
    try:
        text = path.read_text(encoding="utf-8")
        spec = tomllib.loads(text)
    except OSError as error:
        raise ConfigError(f"cannot read the robot TOML {path}: {error.strerror or error}") from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"the robot TOML {path} is not valid TOML: {error}") from error
    _check(spec, path)
    robot = Robot(name=spec["name"], toml_text=text, path=path.resolve(), spec=spec)
    if not robot.mjcf_path.is_file():
        raise ConfigError(f"{path}: mjcf = {spec['mjcf']!r} names no file beside the robot TOML")
    _ = robot.limbs  # a limb that lacks an entry is reported here, not at first use
    return robot


def _check(spec: dict[str, Any], path: Path) -> None:
    """Check the entries which Python reads; the simulator checks all others when an env is made."""
    for key in ("name", "mjcf", "main_body"):
        _entry(spec, key, str, str(path))
    if not _entry(spec, "limbs", list, str(path)):
        raise ConfigError(f"{path}: a robot needs at least one [[limbs]]")
    damage = _entry(spec, "damage", dict, str(path))
    _strings(damage, "types", f"{path}: [damage]")
    _entry(damage, "max_damaged_limbs", int, f"{path}: [damage]")


def _limb(entry: dict[str, Any], index: int, path: Path) -> Limb:
    where = f"{path}: limb {index}"
    if not isinstance(entry, dict):
        raise ConfigError(f"{where}: expected a table [[limbs]], got {entry!r}")
    required = {key: _entry(entry, key, str, where) for key in ("name", "body", "toe_geom")}
    optional = {key: _entry(entry, key, str, where) for key in ("touch", "touch_site") if key in entry}
    joints = _strings(entry, "joints", where)
    if not joints:
        raise ConfigError(f"{where}: joints is empty")
    if unknown := entry.keys() - required.keys() - {"touch", "touch_site", "joints"}:
        raise ConfigError(f"{where}: unknown entries {', '.join(sorted(unknown))}")
    return Limb(joints=joints, **required, **optional)


def _entry(table: dict[str, Any], key: str, kind: type, where: str) -> Any:  # noqa: ANN401 - TOML is untyped
    if key not in table:
        raise ConfigError(f"{where}: the entry {key!r} is missing")
    # A TOML boolean is an int in Python, but no entry of ours is a number that may be written as true.
    if not isinstance(table[key], kind) or (kind is int and isinstance(table[key], bool)):
        raise ConfigError(f"{where}: {key} must be of type {kind.__name__}, got {table[key]!r}")
    return table[key]


def _strings(table: dict[str, Any], key: str, where: str) -> tuple[str, ...]:
    values = _entry(table, key, list, where)
    if not all(isinstance(value, str) for value in values):
        raise ConfigError(f"{where}: {key} must be a list of strings, got {values!r}")
    return tuple(values)
