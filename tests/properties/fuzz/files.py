"""Robot files and configurations."""

from __future__ import annotations

import json
import tomllib
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import dappo_batch

from . import mutate, values
from .room import Room

# How much there is to do: a huge number here is no mistake that a program can know, and would only take long.
WORK = ("steps", "epochs", "episodes", "rollouts", "iterations", "patience", "every", "keep")


# Changes of the MJCF that a robot TOML may contain.
_FAULT = """
[events.imu_fault]
share = 0.5
kinds = ["stuck", "biased", "lost"]
offset = { base_ang_vel = [-0.1, 0.1] }
onset = [0.0, 0.1]
"""
_CHANGES = """
[events.action_dropout]
share = 0.5
every = [0.05, 0.2]
duration = [0.02, 0.1]

[simplify]
floor_contacts = ["north_toe", "west_lower", "plate"]
cone = "pyramidal"
timestep = 0.004
integrator = "euler"
impratio = 1.0
condim = 3

[[override]]
joints = ".*_knee"
armature = 0.02
damping = 0.4
range = [-0.5, 0.5]

[[override]]
actuators = "north_(lift|knee)"
control = "torque"
ctrl_range = [-3, 3]
gear = 2

[[override]]
geoms = ".*_toe"
friction = [0.7, 0.01]
solref = 0.02
"""


@cache
def _text(path: Path) -> str:
    return path.read_text()


def _mutated_toml(rng: Random, source: str) -> str:
    if rng.random() < 0.5:
        return mutate.text(rng, source)
    return mutate.to_toml(mutate.tree(rng, tomllib.loads(source)))


def _write(rng: Random, path: Path, text: str) -> None:
    data = text.encode("utf-8", "surrogatepass")
    path.write_bytes(mutate.raw(rng, data) if rng.random() < 0.1 else data)


def robot_file(rng: Random, room: Room) -> None:
    """Read a robot TOML that is not compiled."""
    (room.folder / "tripod.xml").touch()
    path = room.folder / "robot.toml"
    toml = _text(room.base / "robot" / "tripod.toml") + rng.choice(("", _CHANGES, _FAULT))
    _write(rng, path, _mutated_toml(rng, toml))
    room.call(dappo_batch.load_robot, path)


def robot(rng: Random, room: Room) -> None:
    """Compile a robot and simulate it."""
    toml, xml = (_text(room.base / "robot" / f"tripod.{kind}") for kind in ("toml", "xml"))
    toml = toml.replace("max_damaged_limbs = 3", "max_damaged_limbs = 1") + rng.choice(("", _CHANGES))
    changed = rng.randrange(3)
    if changed != 0:
        toml = _mutated_toml(rng, toml)
    if changed != 1:
        xml = mutate.text(rng, xml)
    path = room.folder / "robot.toml"
    _write(rng, path, toml)
    _write(rng, room.folder / "tripod.xml", xml)
    table = room.call(dappo_batch.compile_class_table, path)
    backend = rng.choice(("auto", "lanes", "mujoco"))
    envs = room.call(dappo_batch.make_vec, table, 2, threads=1, seed=0, backend=backend)
    try:
        room.call(envs.reset)
        for _ in range(2):
            obs, rewards, *_ = room.call(envs.step, np.ones(envs.action_space.shape, np.float32))
            assert np.isfinite(obs).all(), "an observation is not finite"
            assert np.isfinite(rewards).all(), "a reward is not finite"
        room.call(envs.set_state, *room.call(envs.get_state))
    finally:
        envs.close()


def configuration(rng: Random, room: Room) -> None:
    """Read a configuration file."""
    path = room.folder / "config.toml"
    _write(rng, path, _mutated_toml(rng, _text(room.base / "run" / "config.toml")))
    room.command(["config", "--config", str(path)])


def settings(rng: Random, room: Room) -> None:
    """Read settings of the command line."""
    argv = ["config", "--set", *(setting(rng, room) for _ in range(rng.choice((1, 1, 2))))]
    room.command(argv)


@cache
def _keys(base: Path) -> dict[str, Any]:
    """Return the settings of the valid run, by dotted keys."""

    def flat(table: dict[str, Any], above: str = "") -> dict[str, Any]:
        found: dict[str, Any] = {}
        for key, value in table.items():
            found |= flat(value, f"{above}{key}.") if isinstance(value, dict) else {above + key: value}
        return found

    return flat(tomllib.loads(_text(base / "run" / "config.toml")))


def setting(rng: Random, room: Room, *, runs: bool = False) -> str:
    """Return a setting, mostly of an existing key; with `runs`, none that makes a training long."""
    keys = _keys(room.base)
    key = rng.choice(list(keys))
    value = mutate.value(rng, keys[key])
    if runs and any(word in key for word in WORK) and isinstance(value, int | float):
        value = min(value, 9)
    text = f"{key}={mutate.to_toml(value, top=False)}"
    return text if runs or rng.random() < 0.7 else mutate.text(rng, text)


def json_text(rng: Random, source: str) -> str:
    """Return JSON, changed as a tree or as text."""
    return (
        json.dumps(mutate.tree(rng, json.loads(source))) if rng.random() < 0.6 else mutate.text(rng, source)
    )


def toml_text(rng: Random, source: str) -> str:
    """Return TOML, changed as a tree or as text."""
    return _mutated_toml(rng, source)


def odd_name(rng: Random) -> str:
    """Return a name that mostly does not exist."""
    return rng.choice(values.STRINGS)
