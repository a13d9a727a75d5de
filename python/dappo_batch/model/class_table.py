"""The class table: one compiled MuJoCo model for each damage class of a robot."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, get_args

import mujoco

from dappo_batch._checks import folder, integer, mapping, sequence, shown, text
from dappo_batch._core import ConfigError, DamageSpace
from dappo_batch.damage import DamageType, make_damage_type
from dappo_batch.model.body_events import BodyEvents
from dappo_batch.model.floor_pairs import make_floor_contacts_explicit
from dappo_batch.model.mujoco_library import MUJOCO_ERRORS, hidden_state, quiet_mujoco
from dappo_batch.model.requirements import find_parts
from dappo_batch.model.robot_spec import read_robot_spec
from dappo_batch.model.simplify import INTEGRATORS
from dappo_batch.model.variants import (
    ClassTableError,
    Plan,
    Severity,
    Variants,
    check_plan,
    compile_variants,
)
from dappo_batch.model.variants import severity_levels as _severity_levels
from dappo_batch.robots import Robot, load_robot
from dappo_batch.robots.faults import raise_faults
from dappo_batch.terms import import_module

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from dappo_batch._core import DamageClass
    from dappo_batch.results import Edit

__all__ = [
    "ClassTable",
    "ClassTableError",
    "Physics",
    "check_damage_types",
    "compile_class_table",
    "damage_refusals",
]

Physics: TypeAlias = Literal["rk4", "euler"]
"""Integrator of the physics."""

_MOST_MEMORY = 4 << 30
"""Limit of all compiled models, bytes."""

# Sizes of texts may differ: damage may change names, on which the simulation does not depend.
_TEXT_SIZES = {"nnames", "nnames_map", "npaths", "ntextdata", "nbuffer"}


@dataclass(frozen=True, eq=False)
class ClassTable:
    """A robot with one compiled model for each damage class.

    All models have equal sizes, so a state or an ``mujoco.MjData`` can be used with every class.

    Attributes
    ----------
    robot : Robot
        The robot.
    space : DamageSpace
        The damage classes; a class id is an index into `models` and `disabled_touch`.
    severity : float or (float, float)
        Severity of all damage, in (0, 1], or the range that those of episodes are from.
    models : tuple of mujoco.MjModel
        One model per class, [D]; with variants, that of variant 0.
    all_models : tuple of mujoco.MjModel
        The models of all variants, `models` first.
    variants : Variants
        What is random about the models of a class.
    disabled_touch : tuple of tuple of int
        Per class, the limbs whose touch sensor is disabled: it reads 0.
    limb_bodies : tuple of tuple of int
        Per limb, the ids of its bodies.
    touch_addresses : tuple of int
        Per limb, the index of its touch signal in ``sensordata``; empty if the robot has no touch sensors.
    main_body : int
        Id of the body whose x position defines the forward velocity.
    edits : tuple of Edit
        What ``[simplify]`` and ``[[override]]`` of the robot TOML changed.
    """

    robot: Robot
    space: DamageSpace
    severity: Severity
    all_models: tuple[mujoco.MjModel, ...]
    variants: Variants
    disabled_touch: tuple[tuple[int, ...], ...]
    limb_bodies: tuple[tuple[int, ...], ...]
    touch_addresses: tuple[int, ...]
    main_body: int
    edits: tuple[Edit, ...]

    @property
    def models(self) -> tuple[mujoco.MjModel, ...]:
        """One model per class."""
        return self.all_models[: len(self.space.classes)]

    @property
    def nbytes(self) -> int:
        """Memory of all models, bytes."""
        return sum(int(model.nbuffer) for model in self.all_models)

    @property
    def hidden_state(self) -> str:
        """Parts of the robot's state besides positions and velocities; empty if there are none."""
        return hidden_state(self.models[0])

    def worker_data(self, count: int) -> list[mujoco.MjData]:
        """Return `count` new ``mujoco.MjData``, each valid for every class.

        Each worker thread needs one; envs need only states.
        """
        return [mujoco.MjData(self.models[0]) for _ in range(count)]

    def worker_models(self) -> list[mujoco.MjModel]:
        """Return a copy of every model, for a worker thread that changes its numbers from env to env."""
        return [copy.copy(model) for model in self.all_models]


def compile_class_table(
    robot: Robot | str | Path,
    *,
    types: Sequence[str] | None = None,
    max_damaged_limbs: int | None = None,
    max_damages_per_limb: int | None = None,
    severity: Severity = 1.0,
    severity_levels: int = 4,
    physics: Physics | None = None,
    damage_options: Mapping[str, Mapping[str, Any]] | None = None,
) -> ClassTable:
    """Compile one model for each damage class of a robot.

    Every class is an edit of the MJCF that is compiled by MuJoCo, so that masses, inertias and all other
    derived numbers are consistent. Floor contacts become explicit pairs where that changes only the speed.

    Parameters
    ----------
    robot : Robot, str or pathlib.Path
        A robot, a robot's name, or the path of a robot TOML.
    types : sequence of str, optional
        Names of damage types, in the order of enumeration; by default those of the robot TOML.
    max_damaged_limbs : int, optional
        Maximum number of damaged limbs; by default that of the robot TOML.
    max_damages_per_limb : int, optional
        Maximum number of damages of a limb, of different types, which are applied in the order of the types;
        by default that of the robot TOML.
    severity : float or (float, float), optional
        In (0, 1]; 1, the default, is the full damage. With a range ``(low, high)`` the severity of each
        episode is drawn from `severity_levels` values.
    severity_levels : int, optional
        Number of severities that are compiled for a range, evenly spaced with both ends included; 4 by
        default.
    physics : {"rk4", "euler"}, optional
        Integrator; by default that of the MJCF. For the Ant, ``"euler"`` takes a quarter of the time of RK4,
        but the physics differs, so that results cannot be compared.
    damage_options : mapping, optional
        Parameters by damage type; they take precedence over those of the robot TOML.

    Returns
    -------
    ClassTable
        The compiled classes.

    Raises
    ------
    ConfigError
        If the robot or a parameter is invalid, or the MJCF does not meet the requirements; the error lists
        all faults.
    ClassTableError
        If a class does not compile, or its arrays have different sizes from those of the healthy robot.
    """
    if not isinstance(robot, Robot):
        robot = load_robot(folder(robot, "robot") if isinstance(robot, PathLike) else text(robot, "robot"))
    severity, severities = _severity_levels(severity, severity_levels)
    types = None if types is None else [text(name, "a damage type") for name in sequence(types, "types")]
    if max_damaged_limbs is not None:
        max_damaged_limbs = integer(max_damaged_limbs, "max_damaged_limbs", 0)
    if max_damages_per_limb is not None:
        max_damages_per_limb = integer(max_damages_per_limb, "max_damages_per_limb", 1)
    for name, options in mapping({} if damage_options is None else damage_options, "damage_options").items():
        text(name, "a key of damage_options")
        for key in mapping(options, f"damage_options[{name!r}]"):
            text(key, f"a key of damage_options[{name!r}]")
    names = list(robot.damage_types if types is None else types)
    kinds = _damage_types(robot, names, damage_options or {})
    limit = robot.max_damaged_limbs if max_damaged_limbs is None else max_damaged_limbs
    per_limb = robot.damages_per_limb(names, max_damages_per_limb)
    _check_removals(robot, kinds, per_limb)
    space = DamageSpace(len(robot.limbs), names, limit, per_limb)

    plan = Plan(BodyEvents(robot), severities)
    check_plan(robot, plan)

    with quiet_mujoco():
        base, edits = _read_spec(robot, physics)
        specs = plan.bodies.variants(base)
        healthy = _compile_class(specs[0], robot, space.classes[0], kinds, 1.0)
        _check_memory(robot, healthy, len(space.classes), plan.count)
        parts = find_parts(robot, healthy)
        raise_faults(f"robot {robot.name}", _unfit_limbs(base, robot, kinds if limit else {}, severities[-1]))
        sizes = _sizes(healthy)

        def compiled(spec: mujoco.MjSpec, item: DamageClass, severity: float) -> mujoco.MjModel:
            model = _compile_class(spec, robot, item, kinds, severity)
            _check_sizes(item, sizes, model)
            return model

        models, variants = compile_variants(robot, space.classes, kinds, plan, specs, healthy, compiled)
    return ClassTable(
        robot=robot,
        space=space,
        severity=severity,
        all_models=models,
        variants=variants,
        disabled_touch=tuple(
            tuple(sorted({limb for limb, name in item.damages if kinds[name].disables_touch}))
            for item in space.classes
        ),
        limb_bodies=parts.limb_bodies,
        touch_addresses=parts.touch_addresses,
        main_body=parts.main_body,
        edits=edits,
    )


def check_damage_types(robot: Robot, types: Sequence[str]) -> None:
    """Check that the MJCF of a robot matches its TOML, and that damage types can be applied to every limb.

    It takes the time of compiling two or three classes, however many classes the robot has.

    Raises
    ------
    ConfigError
        With all faults.
    """
    kinds = _damage_types(robot, types, {})
    with quiet_mujoco():
        base, _ = _read_spec(robot, None)
        healthy = DamageSpace(len(robot.limbs), types, 0).classes[0]
        find_parts(robot, _compile_class(base, robot, healthy, kinds, 1.0))
        raise_faults(f"robot {robot.name}", _unfit_limbs(base, robot, kinds, 1.0))


def damage_refusals(robot: Robot, types: Sequence[str]) -> dict[str, list[str]]:
    """Return why damage types cannot be applied to limbs, by the types that cannot.

    Raises
    ------
    ConfigError
        If a type does not exist or a parameter is invalid, or the MJCF cannot be read.
    """
    kinds = _damage_types(robot, types, {})
    with quiet_mujoco():
        base, _ = _read_spec(robot, None)
        found = {name: _unfit_limbs(base, robot, {name: kind}, 1.0) for name, kind in kinds.items()}
    return {name: faults for name, faults in found.items() if faults}


def _unfit_limbs(
    base: mujoco.MjSpec, robot: Robot, kinds: Mapping[str, DamageType], severity: float
) -> list[str]:
    """Return the reasons why damage types cannot be applied to limbs."""
    faults = []
    for kind in kinds.values():
        for limb in robot.limbs:
            try:
                kind.apply(base.copy(), limb, severity)
            except ConfigError as error:
                faults.append(str(error))
    return faults


def _check_removals(robot: Robot, kinds: Mapping[str, DamageType], per_limb: int) -> None:
    removing = [name for name, kind in kinds.items() if kind.removes_parts]
    if per_limb > 1 and len(removing) > 1:
        raise ConfigError(
            f"robot {robot.name}: max_damages_per_limb is {per_limb}, but the damage types"
            f" {', '.join(removing)} all remove parts of a limb, which cannot have two of them; list one"
            " of them, or set max_damages_per_limb = 1"
        )


def _check_memory(robot: Robot, model: mujoco.MjModel, classes: int, variants: int) -> None:
    size = classes * variants * int(model.nbuffer)
    if size > _MOST_MEMORY:
        what, remedy = f"{classes} damage classes", "lower max_damaged_limbs or use fewer types"
        if variants > 1:
            what, remedy = f"{variants} variants of {what}", f"use fewer variants, {remedy}"
        raise ConfigError(
            f"robot {robot.name}: {what} of {model.nbuffer} bytes each need"
            f" {size / 2**30:.1f} GiB, the limit is {_MOST_MEMORY / 2**30:.0f}; {remedy}"
        )


def _damage_types(
    robot: Robot, names: Sequence[str], options: Mapping[str, Mapping[str, Any]]
) -> dict[str, DamageType]:
    if len(set(names)) < len(names):
        raise ConfigError(f"damage types must differ, got {', '.join(names)}")
    if unused := options.keys() - set(names):
        raise ConfigError(
            f"damage_options has {', '.join(sorted(unused))}, but the damage types are {', '.join(names)}"
        )
    for module in robot.damage_modules:
        import_module(module)
    kinds, faults = {}, []
    for name in names:
        try:
            kinds[name] = make_damage_type(name, robot.damage_options(name) | dict(options.get(name, {})))
        except ConfigError as error:
            faults.append(str(error))
    raise_faults(f"robot {robot.name}", faults)
    by_class: dict[type[DamageType], str] = {}
    for name, kind in kinds.items():
        if (other := by_class.setdefault(type(kind), name)) != name:
            raise ConfigError(f"the damage types {other} and {name} are two names of the same; list one")
    return kinds


def _read_spec(robot: Robot, physics: str | None) -> tuple[mujoco.MjSpec, tuple[Edit, ...]]:
    spec, edits = read_robot_spec(robot)
    if physics is not None:
        if not isinstance(physics, str) or physics not in get_args(Physics):
            raise ConfigError(f"physics must be one of {', '.join(get_args(Physics))}, got {shown(physics)}")
        spec.option.integrator = INTEGRATORS[physics]
    return spec, edits


def _compile_class(
    base: mujoco.MjSpec,
    robot: Robot,
    damage_class: DamageClass,
    kinds: Mapping[str, DamageType],
    severity: float,
) -> mujoco.MjModel:
    spec = base.copy()
    for limb, name in damage_class.damages:
        try:
            kinds[name].apply(spec, robot.limbs[limb], severity)
        except ConfigError as error:  # each type alone was possible
            raise ClassTableError(f"damage class {damage_class.name}: {error}") from error
    try:
        # After the damage and not once for all classes, as damage may change contact parameters.
        make_floor_contacts_explicit(spec)
        return spec.compile()
    except MUJOCO_ERRORS as error:
        if not damage_class.damages:
            raise ConfigError(
                f"robot {robot.name}: MuJoCo cannot compile {robot.mjcf_path}: {error}"
            ) from error
        raise ClassTableError(f"damage class {damage_class.name} does not compile: {error}") from error


def _sizes(model: mujoco.MjModel) -> dict[str, int]:
    """Return all array sizes of a model by their MuJoCo names."""
    names = (name for name in dir(model) if name.startswith("n") and name not in _TEXT_SIZES)
    values = ((name, getattr(model, name)) for name in names)
    return {name: value for name, value in values if isinstance(value, int)}


def _check_sizes(damage_class: DamageClass, expected: Mapping[str, int], model: mujoco.MjModel) -> None:
    got = ((name, getattr(model, name), size) for name, size in expected.items())
    different = [f"{name} is {found} instead of {size}" for name, found, size in got if found != size]
    if different:
        raise ClassTableError(
            f"damage class {damage_class.name} has other sizes than the healthy robot:"
            f" {', '.join(different)}; damage may change numbers, but neither add nor remove parts"
        )
