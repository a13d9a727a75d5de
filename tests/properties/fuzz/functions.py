"""The commands as functions, with odd arguments."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from random import Random
from typing import Any

import numpy as np

import dappo_batch

from . import mutate, values
from .files import WORK
from .room import Room

SIZES = ("robot", "num_envs", "total_steps", "episodes", "at", "set", "rollouts", "timesteps", "data")
"""Options that are always given, because the defaults would take long."""
TRAINING: dict[str, Any] = {
    **{"num_envs": 2, "total_steps": 16, "seed": 1, "unaware": True, "healthy": False, "reward": "paper"},
    **{"physics": "euler", "backend": "lanes", "precision": "f32", "learner": "cpu", "device": "cpu"},
    "set": {"ppo.hidden": [4], "horizon": 8, "evaluation.episodes": 1, "damage": {"max_damaged_limbs": 1}},
}
NETWORK = {"epochs": 1, "embedding": 3, "lstm": 3, "hidden": [3]}
LEARNING = {"method": "A", "timesteps": 2, "rollouts": 4, "seed": 1, "head": "limbs", "set": NETWORK}
SIMULATION = {"backend": "mujoco", "precision": "f64", "device": "cpu"}
EVALUATION = {"compare": [], "encoding": "wrong", "episodes": 1, "seed": 2, **SIMULATION}
RECORDS = {"rollouts": 2, "timesteps": 2, "preset": "residual", "seed": 1, "shard": "0/2", **SIMULATION}


def functions(rng: Random, room: Room) -> None:
    """Call a command's function."""
    function, arguments, options = rng.choice((_train, _resume, _evaluate, _collect, _learn, _test, _adapt))(
        room
    )
    if rng.random() < 0.3:
        at = rng.randrange(len(arguments))
        arguments[at] = values.anything(rng)
    room.call(function, *arguments, **{"threads": 1, **_changed(rng, options)})


def sweep(rng: Random, room: Room) -> None:
    """Train the cells of a grid in this process."""
    base = _changed(rng, {**TRAINING, "robot": str(room.base / "robot" / "tripod.toml"), "threads": 1})
    grid: Any = {"seed": [1, 2], "ppo.gamma": [0.9]}
    if rng.random() < 0.7:
        grid = mutate.tree(rng, grid) if rng.random() < 0.7 else values.anything(rng)
    if isinstance(grid, dict):
        grid = {key: value for key, value in grid.items() if not _is_work(key)}
    cells = room.call(dappo_batch.sweep, base, grid, "out", executor=_Here())
    for cell in cells:
        assert cell.error is None or "Error: " in cell.error, f"a cell says {cell.error}"


class _Here(Executor):
    """Runs everything at once, in this process."""

    def submit(
        self,
        function: Callable[..., Any],
        /,
        *arguments: Any,  # noqa: ANN401
        **options: Any,  # noqa: ANN401
    ) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(function(*arguments, **options))
        except Exception as error:
            future.set_exception(error)
        return future


def _changed(rng: Random, valid: dict[str, Any]) -> dict[str, Any]:
    """Return options, some missing and some odd, but none that is valid and takes long."""
    chosen = {name: value for name, value in valid.items() if name in SIZES or rng.random() < 0.4}
    for name in rng.sample(list(valid), rng.randrange(3)):
        odd = mutate.value(rng, valid[name]) if rng.random() < 0.5 else values.anything(rng)
        is_long = _is_work(name) and isinstance(odd, int | float | np.number) and not odd <= 9
        chosen[name] = 3 if is_long else odd
    if isinstance(chosen.get("set"), dict):
        work = [
            key for key in chosen["set"] if _is_work(key) and key not in ("evaluation.episodes", "epochs")
        ]
        chosen["set"] = {key: value for key, value in chosen["set"].items() if key not in work}
        for key in chosen["set"].keys() & {"evaluation.episodes", "epochs"}:
            chosen["set"][key] = 1
    return chosen


def _is_work(key: object) -> bool:
    return any(word in str(key) for word in (*WORK, "at"))


def _stop(_: object) -> bool:
    return False


_Call = tuple[Callable[..., Any], list[Any], dict[str, Any]]


def _train(room: Room) -> _Call:
    robot = str(room.base / "robot" / "tripod.toml")
    return dappo_batch.train, ["out"], {**TRAINING, "robot": robot, "callback": _stop}


def _resume(room: Room) -> _Call:
    return dappo_batch.resume, [room.copy("run")], {"total_steps": 32, "learner": "cpu", "callback": _stop}


def _evaluate(room: Room) -> _Call:
    return dappo_batch.evaluate, [room.copy("run")], EVALUATION


def _collect(room: Room) -> _Call:
    return dappo_batch.collect_pairs, [room.base / "run", "out"], {**RECORDS, "policy": room.base / "run"}


def _learn(room: Room) -> _Call:
    return dappo_batch.train_diagnoser, [room.base / "pairs", "out"], {**LEARNING, "callback": _stop}


def _test(room: Room) -> _Call:
    options = {"data": [room.base / "pairs"], "policy": room.base / "run", "episodes": 1}
    return dappo_batch.evaluate_diagnoser, [room.copy("diagnoser")], options


def _adapt(room: Room) -> _Call:
    run = room.base / "run"
    options: dict[str, Any] = {
        **{"damage": "missing_toe@0", "at": 1, "episodes": 1, "seed": 1, "expert": run, "unaware": run},
        **{"controller": {"cooldown": 3}, "log": "log.csv", **SIMULATION},
    }
    return dappo_batch.adapt, [run, room.base / "diagnoser"], options
