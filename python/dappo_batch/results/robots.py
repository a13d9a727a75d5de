"""The report of a checked robot."""

from __future__ import annotations

from dataclasses import dataclass

from dappo_batch._checks import listed
from dappo_batch.results.base import Result

__all__ = ["ActuatorInfo", "Edit", "JointInfo", "Reason", "RobotReport"]


@dataclass(frozen=True)
class Edit(Result):
    """A change of the MJCF by a table of the robot TOML.

    Attributes
    ----------
    table : str
        ``[simplify]``, or ``[[override]]`` and its index.
    entry : str
        Entry of that table, for example ``armature``.
    parts : tuple of str
        The changed joints, actuators or geoms; empty if the whole model was changed.
    before, after : str
        The values, as text.
    """

    table: str
    entry: str
    parts: tuple[str, ...]
    before: str
    after: str

    def __str__(self) -> str:
        """Return the change as a line of text."""
        of = f" of {listed(self.parts)}" if self.parts else ""
        return f"{self.table} {self.entry}{of}: {self.before} → {self.after}"


@dataclass(frozen=True)
class Reason(Result):
    """A reason why the backend ``lanes`` does not support a robot.

    Attributes
    ----------
    text : str
        The feature that it lacks.
    remedy : str
        Entry of ``[simplify]`` or ``[[override]]`` that removes the feature; empty if there is none.
    """

    text: str
    remedy: str


@dataclass(frozen=True)
class JointInfo(Result):
    """A joint.

    Attributes
    ----------
    name : str
        Its name, or that of its body.
    kind : str
        ``hinge``, ``slide`` or ``ball``.
    range : tuple of float or None
        Lowest and highest position, rad or m; None without limits.
    damping, armature, frictionloss, stiffness : float
        As in MJCF, for rad or m.
    """

    name: str
    kind: str
    range: tuple[float, ...] | None
    damping: float
    armature: float
    frictionloss: float
    stiffness: float


@dataclass(frozen=True)
class ActuatorInfo(Result):
    """An actuator.

    Attributes
    ----------
    name : str
        Its name, or that of what it moves.
    control : str
        ``position``, ``velocity``, ``torque``, or ``other``.
    kp, kd : float
        Gains of a servo; 0 for others.
    gear : float
        Ratio of the force on the joint to that of the actuator.
    ctrl_range, force_range : tuple of float or None
        Lowest and highest control (before ``action_scale``) and force; None without limits.
    """

    name: str
    control: str
    kp: float
    kd: float
    gear: float
    ctrl_range: tuple[float, ...] | None
    force_range: tuple[float, ...] | None


@dataclass(frozen=True)
class RobotReport(Result):
    """What a robot is, and which backend and damage types it supports.

    Attributes
    ----------
    robot : str
        Name of the robot.
    mass : float
        Mass of all bodies of the robot, kg.
    timestep : float
        Duration of a physics step, s.
    frame_skip : int
        Physics steps in an env step.
    integrator, cone : str
        As in MJCF: ``rk4``, ``euler``, ``implicit`` or ``implicitfast``; ``pyramidal`` or ``elliptic``.
    joints : tuple of JointInfo
        All joints except free ones, in the order of the MJCF.
    actuators : tuple of ActuatorInfo
        All actuators, in the order of actions.
    floor_contacts : tuple of str
        Geoms of the robot that can touch the world.
    self_collision : bool
        Whether geoms of the robot can touch each other.
    damage_classes : tuple of str
        Names of the compiled damage classes. Damage types that cannot be applied are left out.
    variant_names : tuple of str
        What differs between the compiled variants of a damage class, for example ``mass trunk``.
    variants : tuple of tuple of float
        The numbers of each variant, in the order of their names; empty for a robot without variants.
    models, model_bytes : int
        Number of compiled models of all classes and variants, and their memory.
    edits : tuple of Edit
        What ``[simplify]`` and ``[[override]]`` changed.
    backend : str
        What ``backend="auto"`` uses on the CPU: ``lanes`` or ``mujoco``.
    reasons : tuple of Reason
        Why it is not ``lanes``.
    notes : tuple of str
        In what ``lanes`` deliberately differs from the options of the MJCF.
    asymmetry : str or None
        What differs between left and right, so that ``ppo.symmetry`` is not possible; None if nothing does.
    refusals : tuple of str
        Why damage types cannot be applied to limbs, or damage classes do not compile.
    """

    robot: str
    mass: float
    timestep: float
    frame_skip: int
    integrator: str
    cone: str
    joints: tuple[JointInfo, ...]
    actuators: tuple[ActuatorInfo, ...]
    floor_contacts: tuple[str, ...]
    self_collision: bool
    damage_classes: tuple[str, ...]
    variant_names: tuple[str, ...]
    variants: tuple[tuple[float, ...], ...]
    models: int
    model_bytes: int
    edits: tuple[Edit, ...]
    backend: str
    reasons: tuple[Reason, ...]
    notes: tuple[str, ...]
    asymmetry: str | None
    refusals: tuple[str, ...]
