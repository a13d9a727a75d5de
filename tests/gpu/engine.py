"""The GPU engine: its forces compared with MuJoCo's, and its speed compared with the lane engine's."""

from __future__ import annotations

import json
from collections.abc import Iterator
from itertools import product
from pathlib import Path
from time import perf_counter
from typing import Any

from dappo_batch import make_vec
from dappo_batch._core import ConfigError, LaneWorlds, collect_rollout
from dappo_batch.model import compile_class_table

from ..parity.states import of_all_classes, relative_error
from ..processes import DAPPO_BATCH, run
from .scale import Scale
from .training import pytest_summary

__all__ = ["agreement", "lanes", "rollouts", "speed"]

_TOLERANCES = {"f32": 1e-4, "f64": 1e-10}
_PARITY = Path(__file__).parent.parent / "parity"


def lanes(scale: Scale, seconds: float) -> Iterator[dict[str, Any]]:
    """Time the lane engine on all cores with ``dappo-batch bench``, in env steps per second."""
    for robot in dict.fromkeys(name for name, _ in scale.robots):
        for num_envs in scale.num_envs[1:3]:
            flags = (
                "--robot",
                robot,
                "--envs",
                num_envs,
                "--seconds",
                scale.seconds,
                "--rounds",
                1,
                "--json",
            )
            done = run([*DAPPO_BATCH, "bench", *map(str, flags)], timeout=seconds)
            if done.returncode != 0:
                yield {"ok": False, "robot": robot, "error": done.stderr[-500:]}
                continue
            results = json.loads(done.stdout)["results"]
            rates = {result["key"]: round(result["rate"]["median"]) for result in results}
            yield {"robot": robot, "num_envs": num_envs} | rates


def agreement(scale: Scale, seconds: float) -> Iterator[dict[str, Any]]:
    """Compare forces with MuJoCo's in states of every damage class, then run the tests of the engine."""
    end = perf_counter() + seconds
    for robot in dict.fromkeys(name for name, _ in scale.robots):
        table = compile_class_table(robot)
        for kind, precision in product(("rollout", "hard"), ("f32", "f64")):
            row: dict[str, Any] = {"robot": robot, "states": kind, "precision": precision}
            classes, states, expected = of_all_classes(table, kind, scale.states)
            try:
                worlds = LaneWorlds(table, classes, precision=precision, device="gpu")
            except ConfigError as error:
                # Not every GPU computes in double precision.
                yield row | {"ok": precision == "f64", "error": str(error)}
                continue
            qacc, cfrc_ext, _ = worlds.forward(*states)
            errors = {
                "qacc": relative_error(qacc, expected.qacc),
                "cfrc_ext": relative_error(cfrc_ext, expected.cfrc_ext),
            }
            yield row | {"ok": max(errors.values()) < _TOLERANCES[precision]} | errors
    for tests in ("physics", "backend", "rollouts"):
        command = ("-m", "not slow", str(_PARITY / f"test_gpu_{tests}.py"))
        yield {"tests": tests} | pytest_summary(command, scale.parity, {}, end - perf_counter())


def speed(scale: Scale, _: float) -> Iterator[dict[str, Any]]:
    """Time the vector env on the GPU engine, reward, ends, resets and observation included."""
    for (robot, physics), num_envs in product(scale.robots, scale.num_envs):
        row = {"robot": robot, "physics": physics or "own", "num_envs": num_envs}
        options: Any = {"physics": physics} if physics else {}
        start = perf_counter()
        envs = make_vec(robot, num_envs, device="gpu", damage="uniform", copy=False, seed=0, **options)
        envs.reset()
        actions = [envs.action_space.sample() for _ in range(8)]
        envs.step(actions[0])
        begin = perf_counter()
        steps = 0
        while perf_counter() - begin < scale.seconds:
            envs.step(actions[steps % len(actions)])
            steps += 1
        rate = num_envs * steps / (perf_counter() - begin)
        yield row | {"steps_per_second": round(rate), "start_seconds": begin - start}
        envs.close()


def rollouts(scale: Scale, _: float) -> Iterator[dict[str, Any]]:
    """Time more steps of a rollout in the kernels, policy and copies to the host included."""
    for (robot, physics), num_envs in product(scale.robots, scale.num_envs):
        options: dict[str, Any] = {"robot": robot, "num_envs": num_envs, "seed": 0, "device": "gpu"}
        options |= {"physics": physics} if physics else {}

        def seconds(horizon: int, options: dict[str, Any] = options) -> float:
            start = perf_counter()
            collect_rollout(**options, set={"horizon": horizon})
            return perf_counter() - start

        first = seconds(scale.horizon)
        short, long = seconds(scale.horizon), seconds(3 * scale.horizon)
        yield {
            "robot": robot,
            "physics": physics or "own",
            "num_envs": num_envs,
            "steps_per_second": round(2 * scale.horizon * num_envs / max(long - short, 1e-9)),
            "start_seconds": first,
        }
