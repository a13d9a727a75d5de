"""Parts of a compiled robot that the terms of a task refer to: actuated joints, feet and the default pose."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import mujoco

from dappo_batch._core import ConfigError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dappo_batch.model.class_table import ClassTable
    from dappo_batch.robots import Robot

__all__ = ["Anatomy", "default_pose", "find_anatomy", "foot_faults"]

_HINGE = mujoco.mjtJoint.mjJNT_HINGE
_ANY = (-float("inf"), float("inf"))


@dataclass(frozen=True)
class Joint:
    """A hinge: its indices in qpos and qvel, and its range in rad."""

    name: str
    qpos: int
    dof: int
    range: tuple[float, float]


@dataclass(frozen=True)
class Actuator:
    """An actuator, its hinge if it turns one, and whether its control is a joint position."""

    name: str
    joint: Joint | None
    is_position: bool


@dataclass(frozen=True)
class Hinge:
    """The hinge of a link: axis and anchor in the frame of its body, and the angle of the reference pose."""

    axis: list[float]
    anchor: list[float]
    qpos: int
    dof: int
    reference: float


@dataclass(frozen=True)
class Link:
    """A body between the root and a foot, in the frame of its parent."""

    position: list[float]
    orientation: list[float]
    hinge: Hinge | None


@dataclass(frozen=True)
class Foot:
    """A point of a body, and the bodies from the root to it."""

    body: int
    links: list[Link]
    offset: list[float]


@dataclass(frozen=True)
class Anatomy:
    """What terms refer to; `feet` has an entry for each compiled model, in which limbs may be shorter."""

    start: list[float]
    start_ctrl: list[float]
    actuators: list[Actuator]
    bodies: list[str]
    feet: list[list[Foot]]


def find_anatomy(table: ClassTable) -> Anatomy:
    """Find the parts of a robot in its compiled classes."""
    model = table.models[0]
    names = [limb.foot for limb in table.robot.limbs if limb.foot is not None]
    start = default_pose(table.robot, model)
    actuators = [_actuator(model, index) for index in range(model.nu)]
    return Anatomy(
        start=start,
        start_ctrl=_default_ctrl(table.robot, model, start, actuators),
        actuators=actuators,
        bodies=[model.body(index).name for index in range(model.nbody)],
        feet=[[_foot(model, name) for name in names] for model in table.all_models] if names else [],
    )


def default_pose(robot: Robot, model: mujoco.MjModel) -> list[float]:
    """Return the positions with which an episode begins, those of the keyframe that the robot TOML names.

    Raises
    ------
    ConfigError
        If the MJCF has no such keyframe.
    """
    name = robot.spec["reset"].get("keyframe")
    if name is None:
        return list(map(float, model.qpos0))
    index = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_KEY, name)
    if index < 0:
        known = ", ".join(model.key(key).name for key in range(model.nkey)) or "none"
        raise ConfigError(f"robot {robot.name}: [reset] keyframe: the MJCF has no {name!r}; it has {known}")
    return list(map(float, model.key_qpos[index]))


def _default_ctrl(
    robot: Robot, model: mujoco.MjModel, start: Sequence[float], actuators: Sequence[Actuator]
) -> list[float]:
    """Return the controls of the keyframe, if it has any, or else the positions of the joints."""
    name = robot.spec["reset"].get("keyframe")
    ctrl = None if name is None else model.key(name).ctrl
    if ctrl is not None and ctrl.any():
        return list(map(float, ctrl))
    return [0.0 if item.joint is None else start[item.joint.qpos] for item in actuators]


def foot_faults(robot: Robot, model: mujoco.MjModel, limb_bodies: Sequence[Sequence[int]]) -> list[str]:
    """Return what is wrong with the entries ``foot`` of the limbs."""
    faults = []
    for limb, bodies in zip(robot.limbs, limb_bodies, strict=True):
        if limb.foot is None:
            continue
        found = _find_foot(model, limb.foot)
        if found is None:
            faults.append(f"limb {limb.name}: foot: the MJCF has neither a geom nor a site {limb.foot!r}")
        elif bodies and found[0] not in bodies:
            faults.append(f"limb {limb.name}: foot: {limb.foot} lies on no body of the limb")
    named = sum(limb.foot is not None for limb in robot.limbs)
    if 0 < named < len(robot.limbs):
        faults.append(f"{named} of {len(robot.limbs)} limbs have a foot; give it to all or none")
    return faults


def _actuator(model: mujoco.MjModel, index: int) -> Actuator:
    name = model.actuator(index).name or f"actuator {index}"
    transmission = mujoco.mjtTrn.mjTRN_JOINT
    joint = int(model.actuator_trnid[index, 0])
    if int(model.actuator_trntype[index]) != int(transmission) or int(model.jnt_type[joint]) != int(_HINGE):
        return Actuator(name, None, is_position=False)
    gain, bias = model.actuator_gainprm[index], model.actuator_biasprm[index]
    # force = kp (ctrl - length) - kd velocity, with the length of the joint itself.
    is_position = (
        int(model.actuator_biastype[index]) == int(mujoco.mjtBias.mjBIAS_AFFINE)
        and bool(gain[0] > 0)
        and float(bias[1]) == -float(gain[0])
        and float(model.actuator_gear[index, 0]) == 1.0
    )
    limits = tuple(map(float, model.jnt_range[joint])) if model.jnt_limited[joint] else _ANY
    return Actuator(
        name,
        Joint(
            name=model.joint(joint).name or f"joint {joint}",
            qpos=int(model.jnt_qposadr[joint]),
            dof=int(model.jnt_dofadr[joint]),
            range=(limits[0], limits[1]),
        ),
        is_position,
    )


def _find_foot(model: mujoco.MjModel, name: str) -> tuple[int, list[float]] | None:
    """Return the body of a geom or site, and its centre in the frame of the body."""
    for kind, bodies, centers in (
        (mujoco.mjtObj.mjOBJ_GEOM, model.geom_bodyid, model.geom_pos),
        (mujoco.mjtObj.mjOBJ_SITE, model.site_bodyid, model.site_pos),
    ):
        index = int(mujoco.mj_name2id(model, kind, name))
        if index >= 0:
            return int(bodies[index]), list(map(float, centers[index]))
    return None


def _foot(model: mujoco.MjModel, name: str) -> Foot:
    found = _find_foot(model, name)
    if found is None:  # `foot_faults` has looked for it in the healthy robot
        raise ConfigError(f"foot: a compiled model has neither a geom nor a site {name!r}")
    body, offset = found
    root, links, outer = int(model.jnt_bodyid[0]), [], body
    while outer != root:
        links.append(_link(model, outer))
        outer = int(model.body_parentid[outer])
    return Foot(body, links[::-1], offset)


def _link(model: mujoco.MjModel, body: int) -> Link:
    hinge, count, joint = None, int(model.body_jntnum[body]), int(model.body_jntadr[body])
    if count > 1 or (count == 1 and int(model.jnt_type[joint]) != int(_HINGE)):
        raise ConfigError(
            f"foot: body {model.body(body).name} has {count} joints; between the root and a foot, each body"
            " has at most one, a hinge"
        )
    if count == 1:
        qpos = int(model.jnt_qposadr[joint])
        hinge = Hinge(
            axis=list(map(float, model.jnt_axis[joint])),
            anchor=list(map(float, model.jnt_pos[joint])),
            qpos=qpos,
            dof=int(model.jnt_dofadr[joint]),
            reference=float(model.qpos0[qpos]),
        )
    return Link(
        position=list(map(float, model.body_pos[body])),
        orientation=list(map(float, model.body_quat[body])),
        hinge=hinge,
    )
