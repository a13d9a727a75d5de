"""Command lines: valid ones with words changed, left out, repeated and added."""

from __future__ import annotations

from random import Random

from . import mutate, values
from .files import WORK, setting
from .room import COMMANDS, Room

_DIAGNOSE = ("diagnose", "test", "diagnoser", "--data", "pairs", "--threads", "1")
_LINES: tuple[tuple[str, ...], ...] = (
    *COMMANDS,
    ("evaluate", "run", "--episodes", "1", "--encoding", "true", "--seed", "1", "--threads", "1", "--json"),
    ("evaluate", "run", "--compare", "run", "--backend", "mujoco", "--precision", "f64", "--threads", "1"),
    _DIAGNOSE,
    (*_DIAGNOSE, "--policy", "run", "--episodes", "1", "--json"),
    (
        "adapt",
        "run",
        "--diagnoser",
        "diagnoser",
        "--all-classes",
        "--at",
        "1",
        "--episodes",
        "1",
        "--threads",
        "1",
    ),
    (
        "classes",
        "--robot",
        "robot/tripod.toml",
        "--types",
        "jammed_joint,missing_toe",
        "--max-damaged-limbs",
        "1",
    ),
    ("classes", "--robot", "robot/tripod.toml", "--json"),
    ("check", "robot/tripod.toml", "--types", "jammed_joint", "--max-damaged-limbs", "1", "--json"),
    ("config", "--robot", "robot/tripod.toml", "--unaware", "--physics", "euler"),
    ("config", "--config", "run/config.toml", "--reward", "paper", "--healthy", "--learner", "cpu"),
    (
        "diagnose",
        "train",
        "pairs",
        "--out",
        "o",
        "--method",
        "B",
        "--head",
        "limbs",
        "--held-out",
        "jammed_joint@0",
    ),
)
_FLAGS = (
    *(
        "--threads",
        "--envs",
        "--seed",
        "--robot",
        "--config",
        "--device",
        "--backend",
        "--precision",
        "--reward",
    ),
    *(
        "--physics",
        "--set",
        "--json",
        "--unaware",
        "--healthy",
        "--history",
        "--damage",
        "--expert",
        "--trigger",
        "--controller",
        "--help",
    ),
    *("--shard", "--policy", "--twin-action", "--resync", "--onset", "--delay", "--log", "--run", "--resume"),
    *("--version", "--policy", "--types", "--held-out", "--compare", "-x", "--", "-h"),
)
_PATHS = (
    "run",
    "pairs",
    "diagnoser",
    "export",
    "robot",
    "robot/tripod.toml",
    "missing",
    "run/config.toml",
    "",
)
# Those whose work ends at the first word of the program that called them.
_STOPPED = ("train", "diagnose")


def command_line(rng: Random, room: Room) -> None:
    """Run a changed command line on valid files."""
    room.copy("run", "pairs", "diagnoser", "robot")
    words = list(rng.choice(_LINES))
    if words[0] in ("train", "diagnose") and words[:2] != ["diagnose", "test"]:
        words = ["out" if word == words[-1] and words[-2] in ("--run", "--out") else word for word in words]
    for _ in range(rng.choice((1, 1, 2, 3))):
        _change(rng, room, words)
    words = [word for at, word in enumerate(words) if not _is_long(words, at)]
    if words and words[0] in _STOPPED:
        room.stopped_command([*words, *([] if "--json" in words else ["--json"])])
    else:
        room.command(words)


def _change(rng: Random, room: Room, words: list[str]) -> None:
    at = rng.randrange(1, len(words) + 1) if words else 0
    kind = rng.randrange(8)
    if kind <= 2 and at < len(words):
        words[at] = mutate.text(rng, words[at])
    elif kind == 3 and at < len(words):
        words[at] = rng.choice((*_PATHS, *values.STRINGS))
    elif kind == 4 and at < len(words):
        del words[at]
    elif kind == 5:
        words[at:at] = ["--set", setting(rng, room, runs=True)]
    elif kind == 6:
        odd = rng.choice((str(values.number(rng)), rng.choice(values.STRINGS), rng.choice(_PATHS)))
        words[at:at] = [rng.choice(_FLAGS), odd]
    else:
        words[at:at] = [rng.choice(_FLAGS)]


def _is_long(words: list[str], at: int) -> bool:
    """Whether a word is a valid argument that takes long."""
    word = words[at]
    name, _, number = word.partition("=")
    if not number:
        name, number = (words[at - 1] if at else ""), word
    try:
        return float(number) > 100 and any(part in name for part in (*WORK, "at"))
    except ValueError:
        return False
