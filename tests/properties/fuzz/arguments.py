"""Arguments of the public functions and methods."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from random import Random
from typing import Any

import numpy as np

import dappo_batch
from dappo_batch.render import Walk

from . import mutate, values
from .room import Room

TYPES = ("jammed_joint", "missing_toe", "weak_motor")


@cache
def _table(base: Path) -> dappo_batch.ClassTable:
    return dappo_batch.compile_class_table(base / "robot" / "tripod.toml", max_damaged_limbs=1)


@cache
def _envs(base: Path) -> dappo_batch.DamageVectorEnv:
    return dappo_batch.make_vec(_table(base), 2, seed=0, threads=1)


@cache
def _policy(base: Path) -> dappo_batch.Policy:
    return dappo_batch.Policy.load(base / "run")


@cache
def _diagnoser(base: Path) -> dappo_batch.Diagnoser:
    return dappo_batch.Diagnoser.load(base / "diagnoser", expert=base / "run")


@cache
def _controller(base: Path) -> dappo_batch.Controller:
    return dappo_batch.Controller.from_export(base / "export", num_robots=2)


@cache
def _space() -> dappo_batch.DamageSpace:
    return dappo_batch.DamageSpace(4, TYPES[:2], 2)


def _options(rng: Random, valid: dict[str, Any], most: int = 2) -> dict[str, Any]:
    """Return some options, one or two of them odd."""
    chosen = {name: value for name, value in valid.items() if rng.random() < 0.4}
    for name in rng.sample(list(valid), min(rng.randrange(most + 1), len(valid))):
        chosen[name] = _odd(rng, valid[name])
    return chosen


def _odd(rng: Random, valid: Any) -> Any:  # noqa: ANN401
    if isinstance(valid, str | int | float | list | dict) and rng.random() < 0.5:
        return mutate.value(rng, valid)
    return values.anything(rng)


def damage_spec(rng: Random, room: Room) -> None:
    """Parse damage specs."""
    space = _space()
    if rng.random() < 0.3:
        limbs = rng.choice((1, 3, 4, 6, 20, values.anything(rng)))
        types = rng.choice((list(TYPES[:1]), list(TYPES), ["a", "a"], values.anything(rng)))
        most, per_limb = (rng.choice((1, 0, 2, 3, values.anything(rng))) for _ in range(2))
        space = room.call(dappo_batch.DamageSpace, limbs, types, most, per_limb)
    if rng.random() < 0.3:
        room.call(space.parse, values.anything(rng))
        return
    spec = rng.choice(("healthy", "jammed_joint@0", "jammed_joint@0+missing_toe@2"))
    room.call(space.parse, mutate.text(rng, spec))


def table(rng: Random, room: Room) -> None:
    """Compile class tables, and create envs with them, with odd options."""
    odd: dict[str, Any] = {
        "types": list(TYPES[:2]),
        "max_damaged_limbs": 1,
        "max_damages_per_limb": 2,
        "severity": 0.5,
        "physics": "euler",
    }
    options: dict[str, Any] = {
        "jammed_joint": {"joint": 1, "range_deg": 1.0},
        "weak_motor": {"strength": 0.5},
    }
    odd["damage_options"] = options
    chosen = _options(rng, odd)
    chosen.setdefault("max_damaged_limbs", 1)
    robot = rng.choice((room.base / "robot" / "tripod.toml",) * 6 + (values.anything(rng),))
    compiled = room.call(dappo_batch.compile_class_table, robot, **chosen)
    room.call(dappo_batch.make_vec, compiled, 1, threads=1).close()


def environment(rng: Random, room: Room) -> None:
    """Create and reset envs with odd options."""
    valid: dict[str, Any] = {
        **{"damage": "uniform", "onset": (0, 3), "seed": 1, "reward": "paper", "observe_damage": True},
        **{"damage_duration": (1, 2), "damage_pause": 1, "code_delay": (0, 2), "min_class_steps": 4},
        **{
            "autoreset": "same_step",
            "max_episode_steps": 5,
            "threads": 1,
            "device": "cpu",
            "backend": "lanes",
        },
        **{"precision": "f64", "copy": True, "njmax": 50, "nconmax": 9, "render_mode": None},
    }
    chosen = _options(rng, valid)
    chosen.setdefault("threads", 1)
    number = rng.choice((1, 2, 2, 2, values.anything(rng)))
    envs = room.call(dappo_batch.make_vec, _table(room.base), number, **chosen)
    try:
        room.call(envs.reset, **_options(rng, {"seed": 3, "options": {"damage_class": 1, "onset": 2}}))
        room.call(envs.step, np.zeros(envs.action_space.shape, np.float32))
    finally:
        envs.close()


def steps(rng: Random, room: Room) -> None:
    """Step, reset and set envs with odd arrays."""
    envs = _envs(room.base)
    assert envs.action_space.shape is not None
    model = _table(room.base).models[0]
    room.call(envs.reset, seed=rng.choice((None, 1, [2, None])))
    use = rng.randrange(4)
    if use <= 1:
        actions = values.array(rng, envs.action_space.shape)
        obs, rewards, *_ = room.call(envs.step, actions)
        assert np.isfinite(obs).all(), "an observation is not finite"
        assert np.isfinite(rewards).all(), "a reward is not finite"
    elif use == 2:
        state = [values.array(rng, (2, size), np.float64) for size in (model.nq, model.nv)]
        room.call(envs.set_state, *state)
        obs, *_ = room.call(envs.step, np.zeros(envs.action_space.shape, np.float32))
        assert np.isfinite(obs).all(), "an observation is not finite"
    else:
        names = ("damage_class", "onset", "damage_duration", "damage_pause", "reset_mask", "x")
        odd = {name: values.anything(rng) for name in rng.sample(names, rng.randrange(1, 3))}
        room.call(envs.reset, seed=rng.choice((None, values.anything(rng))), options=odd)


def objects(rng: Random, room: Room) -> None:
    """Call a policy, a diagnoser and a controller with odd arrays."""
    use = rng.randrange(5)
    if use == 0:
        policy = _policy(room.base)
        chosen = rng.choice((None, 1, "healthy", values.anything(rng)))
        room.call(policy.act, values.array(rng, (2, policy.obs_dim)), damage_class=chosen)
    elif use == 1:
        diagnoser = _diagnoser(room.base)
        method = rng.choice((diagnoser.diagnose, diagnoser.twin))
        sizes = (
            (1, diagnoser.timesteps + 1, diagnoser.obs_dim),
            (1, diagnoser.timesteps, diagnoser.action_dim),
        )
        room.call(method, *(values.array(rng, size) for size in sizes))
    elif use == 2:
        room.call(_controller(room.base).reset, values.anything(rng))
    elif use == 3:
        controller = _controller(room.base)
        room.call(controller.reset)
        velocities = values.array(rng, (2,), np.float64)
        actions = room.call(controller.act, values.array(rng, (2, controller.obs_dim)), velocities)
        assert np.isfinite(actions).all(), "an action is not finite"
    else:
        loader = rng.choice(
            (dappo_batch.Policy.load, dappo_batch.load_run, dappo_batch.Controller.from_export)
        )
        room.call(
            loader, rng.choice((values.anything(rng), room.base / rng.choice(("run", "export", "pairs"))))
        )


def walk(rng: Random, room: Room) -> None:
    """Describe a walk to be drawn."""
    table = _table(room.base)
    valid: dict[str, Any] = {
        **{"damage": "missing_toe@0", "onset": 1, "forward_velocity": [0.5, 0.5], "known_names": ["healthy"]},
        **{"note": "x", "events": [{"step": 1, "kind": "suspected"}]},
    }
    states = values.array(rng, (3, table.models[0].nq), np.float64)
    shown = room.call(Walk, table, states, **_options(rng, valid))
    _ = shown.damage_classes, shown.step_seconds


def single_env(rng: Random, room: Room) -> None:
    """Create, reset and step a single env with odd options."""
    valid: dict[str, Any] = {
        "damage": "uniform",
        "onset": (0, 3),
        "max_episode_steps": 5,
        "render_mode": None,
    }
    env = room.call(dappo_batch.DamageEnv, _table(room.base), **_options(rng, valid))
    try:
        room.call(env.reset, **_options(rng, {"seed": 3, "options": {"damage_class": 1, "onset": 2}}))
        room.call(env.step, values.array(rng, env.action_space.shape))
    finally:
        env.close()
