"""Arguments of the environments: checks, conversions and error messages."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import ArrayLike, NDArray

from dappo_batch._checks import array, finite, flags, integer, items, mapping, real, shown
from dappo_batch._core import ConfigError, DamageSpace, ShapeError

DamageSpec: TypeAlias = int | str
"""A class id or a spec string such as ``"jammed_joint@0+missing_toe@2"``."""

Damage: TypeAlias = DamageSpec | Sequence[DamageSpec] | Mapping[str | int, float] | NDArray[Any]
"""``"uniform"``, one class, several classes, a mapping class → weight, or one weight for each class."""

Seed: TypeAlias = int | Sequence[int | None] | None

DRAW = -1
"""In arrays of class ids or steps: drawn by the environment."""

MOST_ENVS = 2**24
MOST_STEPS = 2**31 - 1  # devices count steps with 31 bits
MOST_THREADS = 4096
KEY_LIMIT = 2**64  # random streams are keyed by unsigned 64-bit integers
RESET_OPTIONS = ("damage_class", "onset", "damage_duration", "damage_pause", "reset_mask")


def autoreset_mode(value: str | AutoresetMode) -> AutoresetMode:
    """Return the Gymnasium mode of a name (``"next_step"``, ``"NextStep"`` or the enum member).

    Raises
    ------
    ConfigError
        If there is no such mode.
    """
    if not isinstance(value, str | AutoresetMode):
        raise ConfigError(f"autoreset must be the name of a mode, got {shown(value)}")
    for mode in AutoresetMode:
        if value in (mode, mode.value, mode.name.lower()):
            return mode
    names = ", ".join(repr(mode.name.lower()) for mode in AutoresetMode)
    raise ConfigError(f"autoreset must be one of {names}, got {value!r}")


def class_id(space: DamageSpace, spec: object) -> int:
    """Return the id of the damage class of `spec`, an id or a spec string.

    Raises
    ------
    ConfigError
        If `space` has no such class.
    """
    if isinstance(spec, str):
        return space.parse(spec)
    number = integer(spec, "a damage class id", 0)
    if number >= len(space):
        raise ConfigError(
            f"damage class {number} does not exist: this robot has the classes 0 to {len(space) - 1}"
        )
    return number


def class_weights(space: DamageSpace, damage: Damage) -> NDArray[np.float64] | None:
    """Convert the argument `damage` to one weight for each class.

    Returns
    -------
    weights : array of shape [D] or None
        Not normalised; ``None`` stands for the uniform distribution over all classes.

    Raises
    ------
    ConfigError
        If a class does not exist, a weight is negative or not finite, or all of them are 0.
    ShapeError
        If an array of weights does not have one for each class.
    """
    if isinstance(damage, str) and damage == "uniform":
        return None
    weights: NDArray[np.float64] = np.zeros(len(space))
    if isinstance(damage, Mapping):
        for spec, weight in damage.items():
            weights[class_id(space, spec)] += _weight(spec, weight)
    elif _holds_floats(damage):
        weights = array(damage, "damage weights", np.float64).copy()
        if weights.shape != (len(space),):
            raise ShapeError(
                f"damage weights: expected one per class, shape ({len(space)},), got {weights.shape}"
            )
        if not np.isfinite(weights).all() or (weights < 0.0).any():
            raise ConfigError("damage weights must be finite and not negative")
    else:
        for spec in _listed(damage):
            weights[class_id(space, spec)] += 1.0
    if weights.sum() <= 0.0:
        raise ConfigError(f"damage must have at least one class of positive weight, got {shown(damage)}")
    return weights


def _listed(value: Any) -> list[Any]:  # noqa: ANN401
    """Return a single value as a list of one, and any sequence as a list."""
    each = items(value)
    return [value] if each is None else each


def _holds_floats(damage: object) -> bool:
    if isinstance(damage, np.ndarray):
        return bool(np.issubdtype(damage.dtype, np.floating))
    return (
        isinstance(damage, Sequence)
        and len(damage) > 0
        and all(isinstance(item, float | np.floating) for item in damage)
    )


def _weight(spec: object, value: object) -> float:
    weight = real(value, f"the weight of damage {shown(spec)}")
    if weight < 0.0:
        raise ConfigError(f"the weight of damage {spec!r} must be finite and not negative, got {weight}")
    return weight


def step_range(steps: int | tuple[int, int], name: str, least: int = 0) -> tuple[int, int]:
    """Return the inclusive range of numbers of steps from which the argument `name` is drawn.

    Raises
    ------
    ConfigError
        If a number is not an integer, or less than `least`, or the range is empty.
    """
    each = items(steps)
    low, high = each if each is not None and len(each) == 2 else (steps, steps)
    low, high = integer(low, name, least, MOST_STEPS), integer(high, name, least, MOST_STEPS)
    if high < low:
        raise ConfigError(f"{name}: the range must not be empty, got ({low}, {high})")
    return low, high


def optional_step_range(steps: int | tuple[int, int] | None, name: str) -> tuple[int, int] | None:
    """Return the range of a number of steps that is at least 1, or None.

    Raises
    ------
    ConfigError
        As `step_range`.
    """
    return None if steps is None else step_range(steps, name, 1)


def fresh_keys(num_envs: int) -> NDArray[np.uint64]:
    """Return independent random keys [N] from the operating system's entropy."""
    return np.random.SeedSequence().generate_state(num_envs, np.uint64).astype(np.uint64)


def stream_keys(
    seed: int | Sequence[int | None], num_envs: int
) -> tuple[NDArray[np.uint64], NDArray[np.bool_]]:
    """Return the random key of each env, and whether it was given.

    With an integer the key of env ``i`` is ``seed + i``, as in Gymnasium; ``None`` in a sequence keeps the
    random stream of the env.

    Returns
    -------
    keys : array of shape [N]
        Keys; 0 where none was given.
    given : array of shape [N]
        Whether a key was given.

    Raises
    ------
    ConfigError
        If a seed is not an integer, or not in 0 … 2**64 - 1.
    ShapeError
        If a sequence does not have one seed for each env.
    """
    values = items(seed)
    if values is not None:
        if len(values) != num_envs:
            raise ShapeError(f"seed: expected one seed per env ({num_envs}), got {len(values)}")
    else:
        first = integer(seed, "seed", 0, KEY_LIMIT)
        if first + num_envs > KEY_LIMIT:
            raise ConfigError(f"seed: every env's seed must be below 2**64, got {first + num_envs - 1}")
        return np.uint64(first) + np.arange(num_envs, dtype=np.uint64), np.ones(num_envs, dtype=np.bool_)
    given = np.array([value is not None for value in values], dtype=np.bool_)
    numbers = [0 if value is None else integer(value, "seed", 0, KEY_LIMIT) for value in values]
    if max(numbers) >= KEY_LIMIT:
        raise ConfigError(f"seed: every env's seed must be below 2**64, got {max(numbers)}")
    return np.array(numbers, dtype=np.uint64), given


@dataclass(frozen=True)
class ResetOptions:
    """The ``options`` of a reset; missing ones are None.

    Attributes
    ----------
    mask : array of shape [N] or None
        Envs to reset.
    classes : array of shape [N] or None
        Damage class of the next episode, `DRAW` where the env draws it.
    onsets : array of shape [N] or None
        Onset in episode steps, `DRAW` where the env draws it.
    durations, pauses : array of shape [N] or None
        Steps for which the damage lasts and until it returns, `DRAW` where the env draws them; 0: for good,
        and never.
    """

    mask: NDArray[np.bool_] | None
    classes: NDArray[np.int64] | None
    onsets: NDArray[np.int64] | None
    durations: NDArray[np.int64] | None
    pauses: NDArray[np.int64] | None

    @classmethod
    def parse(cls, options: Mapping[str, Any] | None, space: DamageSpace, num_envs: int) -> ResetOptions:
        """Check the ``options`` of ``reset`` and repeat single values for all envs.

        Raises
        ------
        ConfigError
            If an option is unknown or its value is invalid.
        ShapeError
            If an option has neither one value nor one for each env.
        """
        options = {} if options is None else mapping(options, "options")
        unknown = sorted(set(options) - set(RESET_OPTIONS), key=str)
        if unknown:
            raise ConfigError(f"reset options: unknown {unknown}, expected some of {list(RESET_OPTIONS)}")
        mask = options.get("reset_mask")

        def steps(name: str) -> NDArray[np.int64] | None:
            return _per_env(
                options.get(name), name, num_envs, lambda value: integer(value, name, 0, MOST_STEPS)
            )

        return cls(
            mask=None if mask is None else _reset_mask(mask, num_envs),
            classes=_per_env(
                options.get("damage_class"), "damage_class", num_envs, lambda spec: class_id(space, spec)
            ),
            onsets=steps("onset"),
            durations=steps("damage_duration"),
            pauses=steps("damage_pause"),
        )


def _reset_mask(mask: object, num_envs: int) -> NDArray[np.bool_]:
    chosen = flags(mask, "options['reset_mask']", num_envs)
    if not chosen.any():
        raise ConfigError("options['reset_mask']: at least one env must be selected")
    return chosen


def _per_env(
    value: Any,  # noqa: ANN401
    name: str,
    num_envs: int,
    convert: Callable[[object], int],
) -> NDArray[np.int64] | None:
    """Convert a single value or one value per env; the env draws those that are ``None`` or `DRAW`."""
    if value is None:
        return None
    values = _listed(value)
    if len(values) == 1:
        values *= num_envs
    if len(values) != num_envs:
        raise ShapeError(f"options[{name!r}]: expected one value or {num_envs}, got {len(values)}")
    return np.array([DRAW if _is_draw(item) else convert(item) for item in values], dtype=np.int64)


def _is_draw(item: object) -> bool:
    return item is None or (isinstance(item, int | np.integer) and item == DRAW)


def state(
    qpos: object, qvel: object, qpos_shape: tuple[int, ...], qvel_shape: tuple[int, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return positions and velocities as contiguous float64 arrays of finite numbers.

    Raises
    ------
    ShapeError
        If an array has another shape.
    ConfigError
        If it contains anything but finite numbers.
    """
    found = []
    for name, value, shape in (("qpos", qpos, qpos_shape), ("qvel", qvel, qvel_shape)):
        values = array(value, name, np.float64)
        if values.shape != shape:
            raise ShapeError(f"{name}: expected shape {shape}, got {values.shape}")
        finite(values, name)
        found.append(values)
    return found[0], found[1]


def action_batch(actions: ArrayLike, shape: tuple[int, ...]) -> NDArray[np.float32]:
    """Return `actions` as a contiguous float32 array, without a copy if it is one.

    Raises
    ------
    ShapeError
        If the array does not have `shape`.
    ConfigError
        If its type cannot be converted to float32 (complex, text, objects).
    """
    rows = array(actions, f"actions: expected shape {shape}", np.float32)
    if rows.shape != shape:
        raise ShapeError(f"actions: expected shape {shape}, got {rows.shape}")
    return rows
