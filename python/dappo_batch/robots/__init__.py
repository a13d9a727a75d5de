"""Robots: an MJCF file and a robot TOML each, without code.

A robot is added by putting ``<name>.xml`` and ``<name>.toml`` into this folder. Every argument for a robot
also accepts the path of a robot TOML.
"""

from __future__ import annotations

import os
import tomllib
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from dappo_batch._checks import folder
from dappo_batch._core import ConfigError, robot_faults, robot_task, robot_with_task
from dappo_batch.robots.faults import raise_faults

__all__ = ["DEFAULT_ROBOT", "ROBOTS", "TASKS", "Limb", "Robot", "built_in_config", "load_robot"]

_FOLDER = Path(__file__).resolve().parent

ROBOTS: tuple[str, ...] = tuple(sorted(path.stem for path in _FOLDER.glob("*.toml")))
"""Names of the built-in robots."""

_TASKS = _FOLDER.parent / "tasks"

TASKS: tuple[str, ...] = tuple(sorted(path.stem for path in _TASKS.glob("*.toml")))
"""Names of the built-in tasks."""

DEFAULT_ROBOT = "ant"
"""The default robot of commands."""

_CONFIGS = _FOLDER.parent / "configs"

_MOST_BYTES = 1 << 20


@dataclass(frozen=True)
class Limb:
    """One limb of a robot: a body and everything below it.

    Attributes
    ----------
    name : str
        Name in messages.
    body : str
        Root body of the limb in the MJCF.
    joints : tuple of str
        Joints from the torso outwards.
    toe_geom : str or None
        Geom of the lowest segment, which the damage type ``missing_shank`` shortens; without one it is found.
    touch : str or None
        Touch sensor of the limb.
    touch_site : str or None
        Site of the touch sensor; it is shortened together with the toe.
    foot : str or None
        Geom or site whose centre is the foot, for the terms of a task that refer to feet.
    keyframe : str or None
        Keyframe of the MJCF with the default pose of the robot, ``[reset] keyframe`` of the robot TOML.
    """

    name: str
    body: str
    joints: tuple[str, ...]
    toe_geom: str | None = None
    touch: str | None = None
    touch_site: str | None = None
    foot: str | None = None
    keyframe: str | None = None


@dataclass(frozen=True)
class Robot:
    """A robot TOML after its check.

    Attributes
    ----------
    name : str
        Name of the robot.
    toml_text : str
        Text of the robot TOML, which contains the entries of its task.
    path : pathlib.Path
        Path of the robot TOML.
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
        """Body whose x position defines the forward velocity."""
        return str(self.spec["main_body"])

    @cached_property
    def limbs(self) -> tuple[Limb, ...]:
        """Limbs in ring order."""
        keyframe = self.spec["reset"].get("keyframe")
        return tuple(_limb(entry, keyframe) for entry in self.spec["limbs"])

    @property
    def damage_types(self) -> tuple[str, ...]:
        """Names of the damage types, in the order in which damage classes are enumerated."""
        return tuple(self.spec["damage"]["types"])

    @property
    def max_damaged_limbs(self) -> int:
        """Maximum number of damaged limbs."""
        return int(self.spec["damage"]["max_damaged_limbs"])

    def damages_per_limb(self, types: Sequence[str], given: int | None = None) -> int:
        """Return the maximum number of damages of a limb with these damage types.

        If it is not given, it is that of the robot TOML, but at most the number of types.
        """
        own = int(self.spec["damage"].get("max_damages_per_limb", 1))
        return min(own, max(len(types), 1)) if given is None else given

    @property
    def damage_modules(self) -> tuple[str, ...]:
        """Modules of the user that register damage types."""
        return tuple(self.spec["damage"].get("modules", ()))

    def damage_options(self, damage_type: str) -> dict[str, Any]:
        """Return the parameters of a damage type, a copy of the table ``[damage.<damage_type>]``."""
        return dict(self.spec["damage"].get(damage_type, {}))


def built_in_config(robot: str | None = None) -> tuple[str, str] | None:
    """Read the training configuration of a built-in robot.

    Parameters
    ----------
    robot : str, optional
        Name of the robot, by default `DEFAULT_ROBOT`.

    Returns
    -------
    tuple of str or None
        File name and TOML text; None for a robot without one.
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
        If the robot is unknown, or its TOML cannot be read or has faults; the error lists all of them.
    """
    if isinstance(name_or_path, str) and name_or_path in ROBOTS:
        path = _FOLDER / f"{name_or_path}.toml"
    else:
        path = folder(name_or_path, "name_or_path")
        if path.suffix != ".toml":
            raise ConfigError(
                f"unknown robot {str(name_or_path)!r}: expected one of {', '.join(ROBOTS)}, or the path of a"
                " robot TOML (a file that ends in .toml; copy robots/ant.toml to write one)"
            )
    text = _with_task(_read(path), path)
    faults = robot_faults(text)
    raise_faults(f"the robot TOML {path}", faults)
    try:
        spec = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise ConfigError(f"the robot TOML {path} is not valid TOML 1.0: {error}") from error
    robot = Robot(name=spec["name"], toml_text=text, path=path.resolve(), spec=spec)
    # Unlike pathlib's functions it returns False for a name that is too long.
    if not os.path.isfile(robot.mjcf_path):
        raise ConfigError(f"{path}: mjcf = {spec['mjcf']!r} is not a file in the folder of the robot TOML")
    return robot


def _with_task(text: str, path: Path) -> str:
    """Return the text of a robot TOML with the entries of the task that its entry ``task`` names."""
    name = robot_task(text)
    if name is None:
        return text
    if name in TASKS:
        file = _TASKS / f"{name}.toml"
    elif name.endswith(".toml"):
        file = path.parent / name
    else:
        raise ConfigError(
            f"the robot TOML {path}: `task` is {name!r}, expected one of {', '.join(TASKS)}, or the path of a"
            " task TOML (a file that ends in .toml), relative to the robot TOML"
        )
    try:
        return robot_with_task(text, _read(file, "task"), file.stem)
    except ConfigError as error:
        raise ConfigError(f"the robot TOML {path}: {error}") from error


def _read(path: Path, kind: str = "robot") -> str:
    try:
        if path.exists() and not path.is_file():
            raise ConfigError(f"cannot read the {kind} TOML {path}: it is not a regular file")
        with path.open("rb") as file:
            # One byte more than the limit, so that the check fails for larger files.
            return file.read(_MOST_BYTES + 1).decode("utf-8")
    except OSError as error:
        raise ConfigError(f"cannot read the {kind} TOML {path}: {error.strerror or error}") from error
    except ValueError as error:  # not UTF-8, or a zero byte in the path
        raise ConfigError(f"cannot read the {kind} TOML {path}: {error}") from error


def _limb(entry: dict[str, Any], keyframe: str | None) -> Limb:
    return Limb(**{**entry, "joints": tuple(entry["joints"])}, keyframe=keyframe)
