"""Compiled variants of the damage classes: what is random about a robot and needs MuJoCo's compiler."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

from dappo_batch._checks import integer, items, real, shown
from dappo_batch._core import ConfigError, DappoError
from dappo_batch.robots.faults import raise_faults

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    import mujoco

    from dappo_batch._core import DamageClass
    from dappo_batch.damage import DamageType
    from dappo_batch.damage.base import MovingLimits
    from dappo_batch.model.body_events import BodyEvents
    from dappo_batch.robots import Robot

__all__ = [
    "SEVERITY",
    "ClassTableError",
    "Jam",
    "Plan",
    "Severity",
    "Variants",
    "check_plan",
    "compile_variants",
    "severity_levels",
]

SEVERITY = "severity"
"""Name of the severity among the numbers of a variant."""

Severity: TypeAlias = float | tuple[float, float]
"""One severity, or the range that those of episodes are from."""


class ClassTableError(DappoError):
    """A damage class does not compile, or its model has other sizes than the healthy one."""


@dataclass(frozen=True)
class Jam:
    """Limits of a joint of a model that move with its position at the onset; see `MovingLimits`."""

    joint: int
    qpos: int
    dof: int
    compiled_at: float
    range: tuple[float, float]
    share: float


@dataclass(frozen=True)
class Variants:
    """The compiled models behind the damage classes.

    Attributes
    ----------
    names : tuple of str
        Names of what differs: for example ``"mass trunk"`` (a factor) or ``"severity"``.
    numbers : tuple of tuple of float
        The numbers of each variant, [V, names]; empty for a robot without variants.
    models : tuple of tuple of int
        Indices into `ClassTable.all_models`, [D, V].
    jams : tuple of tuple of Jam
        Joints of each model of `ClassTable.all_models` that jam where they are; empty if none does.
    """

    names: tuple[str, ...] = ()
    numbers: tuple[tuple[float, ...], ...] = ()
    models: tuple[tuple[int, ...], ...] = ()
    jams: tuple[tuple[Jam, ...], ...] = ()


@dataclass(frozen=True)
class Plan:
    """The variants of a robot before they are compiled."""

    bodies: BodyEvents
    severities: tuple[float, ...]
    """Severity of each variant, [V], or of all if it is one."""

    @property
    def count(self) -> int:
        """Number of variants, at least 1."""
        return max(len(self.bodies.numbers), len(self.severities))

    def severity(self, variant: int) -> float:
        """Return the severity of a variant."""
        return self.severities[variant % len(self.severities)]

    def described(self) -> tuple[tuple[str, ...], tuple[tuple[float, ...], ...]]:
        """Return the names and numbers of the variants."""
        names, numbers = self.bodies.names, self.bodies.numbers
        if len(self.severities) > 1:
            rows = numbers or ((),) * self.count
            numbers = tuple((*row, self.severity(index)) for index, row in enumerate(rows))
            names = (*names, SEVERITY)
        return names, numbers


def severity_levels(severity: object, levels: object = 4) -> tuple[Severity, tuple[float, ...]]:
    """Return a severity, or a range of them, after a check, and the severities that are compiled.

    Raises
    ------
    ConfigError
        If they are out of range.
    """
    count = integer(levels, "severity_levels", 2, 1000)
    bounds = items(severity)
    if bounds is None:
        one = real(severity, "severity")
        if not 0.0 < one <= 1.0:
            raise ConfigError(f"severity must be above 0 and at most 1, got {one}")
        return one, (one,)
    low, high = (real(bound, "a bound of severity") for bound in bounds) if len(bounds) == 2 else (1.0, 0.0)
    if not 0.0 < low < high <= 1.0:
        raise ConfigError(
            "severity must be a number, or a range (low, high) with 0 < low < high <= 1, got"
            f" {shown(severity)}"
        )
    steps = tuple(low + (high - low) * step / (count - 1) for step in range(count - 1))
    return (low, high), (*steps, high)


def check_plan(robot: Robot, plan: Plan) -> None:
    """Raise if random bodies and random severities cannot be combined."""
    samples, levels = len(plan.bodies.numbers), len(plan.severities)
    if samples and samples % levels:
        raise ConfigError(
            f"robot {robot.name}: [events] variants = {samples} must be a multiple of the {levels} levels of"
            " the severity, so that each of them has as many variants"
        )


def compile_variants(
    robot: Robot,
    classes: Sequence[DamageClass],
    kinds: Mapping[str, DamageType],
    plan: Plan,
    specs: Sequence[mujoco.MjSpec],
    healthy: mujoco.MjModel,
    compiled: Callable[[mujoco.MjSpec, DamageClass, float], mujoco.MjModel],
) -> tuple[tuple[mujoco.MjModel, ...], Variants]:
    """Compile all classes in all variants, each different model once.

    Parameters
    ----------
    robot : Robot
        The robot.
    classes : sequence of DamageClass
        The damage classes.
    kinds : mapping
        Damage types by name.
    plan : Plan
        The variants.
    specs : sequence of mujoco.MjSpec
        The robot in all variants, or one if its bodies are the same in all of them.
    healthy : mujoco.MjModel
        Class 0 in variant 0.
    compiled : callable
        Compiles a class with a severity.

    Returns
    -------
    models : tuple of mujoco.MjModel
        Those of variant 0 of all classes first.
    variants : Variants
        What they are.

    Raises
    ------
    ClassTableError
        With the faults of all classes of a variant.
    """
    models, known = [healthy], {(0, 0, 0.0): 0}
    jams: list[tuple[Jam, ...]] = [()]
    indices: list[list[int]] = [[] for _ in classes]
    for variant in range(plan.count):
        body, faults = variant % len(specs), []
        for item, row in zip(classes, indices, strict=True):
            severity = plan.severity(variant) if item.damages else 0.0
            key = (item.id, body, severity)
            if key not in known:
                try:
                    models.append(compiled(specs[body], item, severity))
                except ClassTableError as fault:
                    faults.append(str(fault))
                    continue
                jams.append(_jams(healthy, specs[body], robot, item, kinds, severity))
                known[key] = len(models) - 1
            row.append(known[key])
        raise_faults(f"robot {robot.name}", faults, ClassTableError)
    names, numbers = plan.described()
    indexed = tuple(map(tuple, indices)) if plan.count > 1 else ()
    return tuple(models), Variants(names, numbers, indexed, tuple(jams) if any(jams) else ())


def _jams(
    healthy: mujoco.MjModel,
    spec: mujoco.MjSpec,
    robot: Robot,
    damage_class: DamageClass,
    kinds: Mapping[str, DamageType],
    severity: float,
) -> tuple[Jam, ...]:
    """Return the joints of a class that jam where they are."""
    damages = ((kinds[name], robot.limbs[limb]) for limb, name in damage_class.damages)
    found = (kind.moving_limits(spec, limb, severity) for kind, limb in damages)
    return tuple(_jam(healthy, limits) for limits in found if limits is not None)


def _jam(model: mujoco.MjModel, limits: MovingLimits) -> Jam:
    joint = model.joint(limits.joint).id
    return Jam(
        joint=int(joint),
        qpos=int(model.jnt_qposadr[joint]),
        dof=int(model.jnt_dofadr[joint]),
        compiled_at=limits.compiled_at,
        range=limits.range,
        share=limits.share,
    )
