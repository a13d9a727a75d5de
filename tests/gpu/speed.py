"""Env steps per second of the captured step, and the time of its parts."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator
from functools import partial
from itertools import product
from time import perf_counter
from typing import Any

import warp as wp

from dappo_batch.kernels.captured_step import CapturedStep
from dappo_batch.kernels.task import Task
from dappo_batch.model import compile_class_table

from .scale import Scale
from .setting import collector, device_arrays

__all__ = ["speed"]


def speed(scale: Scale) -> Iterator[dict[str, Any]]:
    """Time every robot, integrator and number of solver iterations, with one row for each.

    Yields
    ------
    dict
        ``robot``, ``integrator``, ``iterations``, ``num_envs``; ``steps_per_second`` of rollouts, copied
        to the host; milliseconds an env step of all envs: ``policy_ms``, ``physics_ms`` (with reward and
        observation), ``rest_ms`` (ends, resets, records), ``copy_ms``; ``start_seconds`` with compilation and
        capture; ``memory_mib`` on a GPU. Or ``skipped``, with the reason.
    """
    for robot, integrator, iterations in product(scale.warp_robots, scale.integrators, scale.iterations):
        row: dict[str, Any] = {"robot": robot, "integrator": integrator, "iterations": iterations}
        table = compile_class_table(robot, physics=integrator)
        for model in table.models:
            model.opt.iterations = iterations
        row["num_envs"] = scale.warp_envs
        try:
            yield row | _measure(Task.of(table), scale.warp_envs, scale)
        except RuntimeError as error:  # usually too little memory
            yield row | {"skipped": f"{type(error).__name__}: {error}"}
        gc.collect()


def _measure(task: Task, num_envs: int, scale: Scale) -> dict[str, Any]:
    device = wp.get_device()
    free = device.free_memory if device.is_cuda else 0
    start = perf_counter()
    captured = collector(task, num_envs, scale.horizon, scale.hidden)
    captured.collect(0)
    wp.synchronize()
    start_seconds = perf_counter() - start
    memory = {"memory_mib": round((free - device.free_memory) / 2**20)} if device.is_cuda else {}
    steps = scale.horizon * scale.rollouts

    def rollouts() -> None:
        for number in range(scale.rollouts):
            captured.collect((number + 1) * scale.horizon)

    def copies() -> None:
        for _ in range(scale.rollouts):
            for array in device_arrays(captured.rollout).values():
                array.numpy()

    rollout, copy = _seconds(rollouts), _seconds(copies)
    parts = []
    for graph in _parts(captured):
        captured.worlds.reset()
        parts.append(_seconds(partial(_launch, graph, steps)))
    policy, physics = parts
    in_ms = 1000.0 / steps
    return {
        "steps_per_second": round(num_envs * steps / (rollout + copy)),
        "policy_ms": in_ms * policy,
        "physics_ms": in_ms * physics,
        "rest_ms": in_ms * (rollout - policy - physics),
        "copy_ms": in_ms * copy,
        "start_seconds": start_seconds,
    } | memory


def _launch(graph: Any, times: int) -> None:  # noqa: ANN401 - a type of Warp
    for _ in range(times):
        wp.capture_launch(graph)


def _seconds(work: Callable[[], Any]) -> float:
    wp.synchronize()
    start = perf_counter()
    work()
    wp.synchronize()
    return perf_counter() - start


def _parts(captured: CapturedStep) -> list[Any]:
    """Capture the policy and the physics of a step separately, without rewards and episodes."""
    worlds, policy, rollout = captured.worlds, captured.policy, captured.rollout

    def act() -> None:
        policy.act(worlds.obs, worlds.episodes.key, rollout.step)
        policy.evaluate(worlds.episode_ends.final_obs, worlds.episode_ends.truncated)

    graphs = []
    for part in (act, lambda: worlds.advance(policy.actions)):
        part()
        with wp.ScopedCapture() as capture:
            part()
        graphs.append(capture.graph)
    return graphs
