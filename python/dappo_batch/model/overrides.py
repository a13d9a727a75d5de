"""``[[override]]``: other values for the joints, actuators and geoms whose names match an expression."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import mujoco
import numpy as np

from dappo_batch._checks import listed
from dappo_batch.model.edits import EditLog, shown_number

__all__ = ["apply_overrides", "can_collide", "geom_label"]

Item: TypeAlias = Mapping[str, Any]

_LIMITED = mujoco.mjtLimited.mjLIMITED_TRUE
_AUTO = mujoco.mjtLimited.mjLIMITED_AUTO
_DYN = mujoco.mjtDyn
_ANGLES = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_BALL)


def apply_overrides(spec: mujoco.MjSpec, overrides: Sequence[Item], log: EditLog) -> None:
    """Apply the tables ``[[override]]`` of a robot TOML, in their order.

    Parameters
    ----------
    spec : mujoco.MjSpec
        The robot, edited in place.
    overrides : sequence of mapping
        The tables.
    log : EditLog
        Receives what was changed, and why a table cannot be applied.
    """
    for index, item in enumerate(overrides):
        table = f"[[override]] {index}"
        key = next(key for key in _KINDS if key in item)
        kind = _KINDS[key]
        for name, part in _selected(table, key, item[key], kind.named(spec), log):
            kind.override(table, item, name, part, log)


def _selected(
    table: str, key: str, expression: str, named: list[tuple[str, Any]], log: EditLog
) -> list[tuple[str, Any]]:
    """Return the parts whose names match a regular expression."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            pattern = re.compile(expression)
    except (re.error, Warning, OverflowError, RecursionError) as error:
        log.faults.append(f"{table}: {key} = {expression!r} is not a regular expression: {error}")
        return []
    found = [(name, part) for name, part in named if pattern.fullmatch(name)]
    if not found:
        names = listed(name for name, part in named if key != "joints" or not _is_free(part)) or "none"
        log.faults.append(f"{table}: no {key[:-1]} matches {expression!r}; the robot has {names}")
    if key == "joints" and not all(_is_free(part) for _, part in found):
        # An expression for all joints is not meant for the one with which the robot moves freely.
        return [(name, part) for name, part in found if not _is_free(part)]
    if key == "geoms" and found and not any(can_collide(part) for _, part in found):
        log.faults.append(
            f"{table}: no geom that matches {expression!r} ({listed(name for name, _ in found)}) can touch"
            " anything by its contype and conaffinity, so its contacts have no settings"
        )
    return found if key != "geoms" else [(name, part) for name, part in found if can_collide(part)]


def _is_free(joint: mujoco.MjsJoint) -> bool:
    return bool(joint.type == mujoco.mjtJoint.mjJNT_FREE)


def can_collide(geom: mujoco.MjsGeom) -> bool:
    """Return whether the masks of a geom allow contacts."""
    return bool(geom.contype or geom.conaffinity)


def geom_label(geom: mujoco.MjsGeom) -> str:
    """Return the name of a geom, or that of its body if it has none."""
    return geom.name or f"a geom of {geom.parent.name or 'a body without a name'}"


def _override_joint(table: str, item: Item, name: str, joint: mujoco.MjsJoint, log: EditLog) -> None:
    if _is_free(joint) and (odd := [key for key in ("stiffness", "range") if key in item]):
        log.faults.append(f"{table}: joint {name} is free, so it has no {' and no '.join(odd)}")
        return
    for key in ("armature", "frictionloss", "damping", "stiffness"):
        if key in item:
            log.record(table, key, name, _plain(getattr(joint, key)), item[key])
            _set_scalar(joint, key, float(item[key]))
    if "range" in item:
        unit = math.degrees(1.0) if joint.type in _ANGLES and joint.compiler.degree else 1.0
        before = np.asarray(joint.range) / unit if _is_limited(joint.limited, joint.range) else "none"
        log.record(table, "range", name, before, item["range"])
        joint.range = [bound * unit for bound in item["range"]]
        joint.limited = _LIMITED


def _plain(value: Any) -> Any:  # noqa: ANN401 - a number or an array, depending on the version of MuJoCo
    """Return the coefficient of a polynomial if it is linear."""
    array = np.atleast_1d(np.asarray(value, dtype=float))
    return array if array[1:].any() else array[0]


def _set_scalar(joint: mujoco.MjsJoint, key: str, value: float) -> None:
    """Set a number, or a polynomial with this linear coefficient alone."""
    size = np.size(getattr(joint, key))
    setattr(joint, key, value if size == 1 else [value] + [0.0] * (size - 1))


def _is_limited(limited: int, bounds: Sequence[float] | np.ndarray) -> bool:
    """Return whether a range is active; without ``limited`` it is if it is not empty."""
    return bool(limited == _LIMITED or (limited == _AUTO and bounds[0] < bounds[1]))


def _is_servo(actuator: mujoco.MjsActuator) -> bool:
    """Return whether the force is kp times the distance to the control or its activation."""
    affine = (
        actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED and actuator.biastype == mujoco.mjtBias.mjBIAS_AFFINE
    )
    return bool(affine and actuator.biasprm[1] and actuator.gainprm[0] == -actuator.biasprm[1])


def _control(actuator: mujoco.MjsActuator) -> str:
    """Return what the control of an actuator is, except for a filter: `position`, `torque` or `other`."""
    if actuator.dyntype not in (_DYN.mjDYN_NONE, _DYN.mjDYN_FILTER, _DYN.mjDYN_FILTEREXACT):
        return "other"
    if _is_servo(actuator):
        return "position"
    fixed = actuator.gaintype == mujoco.mjtGain.mjGAIN_FIXED
    return "torque" if fixed and actuator.biastype == mujoco.mjtBias.mjBIAS_NONE else "other"


def _override_actuator(table: str, item: Item, name: str, actuator: mujoco.MjsActuator, log: EditLog) -> None:
    if fault := _unclear(item, name, actuator):
        log.faults.append(f"{table}: {fault}")
        return
    if "control" in item:
        filtered = " with a filter or an activation" if actuator.dyntype != _DYN.mjDYN_NONE else ""
        log.record(table, "control", name, _control(actuator) + filtered, item["control"])
    if item.get("control") == "torque":
        if _control(actuator) != "torque":
            actuator.set_to_motor()
            actuator.inheritrange = 0.0
        _remove_activation(actuator)
    elif item.keys() & {"control", "kp", "kd"}:
        _set_gains(table, item, name, actuator, log)
    for key, field in (("force_range", "force"), ("ctrl_range", "ctrl")):
        if key in item:
            bounds, limited = getattr(actuator, f"{field}range"), getattr(actuator, f"{field}limited")
            before = bounds if _is_limited(limited, bounds) else "none"
            log.record(table, key, name, before, item[key])
            setattr(actuator, f"{field}range", item[key])
            setattr(actuator, f"{field}limited", _LIMITED)
    if "ctrl_range" in item:
        actuator.inheritrange = 0.0
    if "gear" in item:
        log.record(table, "gear", name, actuator.gear[0], item["gear"])
        actuator.gear[0] = item["gear"]


def _unclear(item: Item, name: str, actuator: mujoco.MjsActuator) -> str | None:
    """Return what is missing in a table, or has no meaning for an actuator."""
    control = _control(actuator)
    gain = next((key for key in ("kp", "kd") if key in item), None)
    if "control" not in item:
        if gain is None or _is_servo(actuator):
            return None
        return f'actuator {name} has no position control, so no {gain}; add control = "position"'
    if item["control"] == "position" and control != "position" and "kp" not in item:
        return f'control = "position" of actuator {name} needs a kp'
    is_limited = _is_limited(actuator.ctrllimited, actuator.ctrlrange) or actuator.inheritrange > 0
    if control != item["control"] and is_limited and "ctrl_range" not in item:
        bounds = "that of its joint" if actuator.inheritrange > 0 else shown_number(actuator.ctrlrange)
        return (
            f"the control of actuator {name} becomes a {item['control']}, which its range ({bounds}) was not"
            " made for; add ctrl_range"
        )
    return None


def _set_gains(table: str, item: Item, name: str, actuator: mujoco.MjsActuator, log: EditLog) -> None:
    """Set the gains of a position servo; those that a table leaves out remain."""
    was_servo = _is_servo(actuator)
    kp, bias = (float(actuator.gainprm[0]), float(actuator.biasprm[2])) if was_servo else (0.0, 0.0)
    if "kp" in item:
        log.record(table, "kp", name, kp if was_servo else "none", item["kp"])
    if "kd" in item:
        # A positive number is a ratio of damping, from which MuJoCo computes the gain.
        before = f"damping ratio {bias:.6g}" if bias > 0 else abs(bias)
        log.record(table, "kd", name, before if was_servo else "none", item["kd"])
    if "control" in item:
        inherited = actuator.inheritrange if was_servo else 0.0
        actuator.set_to_position(1.0)
        actuator.inheritrange = inherited
        _remove_activation(actuator)
    gain = float(item.get("kp", kp))
    actuator.gainprm[0], actuator.biasprm[1] = gain, -gain
    actuator.biasprm[2] = -float(item["kd"]) if "kd" in item else bias


def _remove_activation(actuator: mujoco.MjsActuator) -> None:
    actuator.dyntype = _DYN.mjDYN_NONE
    actuator.actrange, actuator.actlimited = [0.0, 0.0], _AUTO


def _override_geom(table: str, item: Item, name: str, geom: mujoco.MjsGeom, log: EditLog) -> None:
    for key in ("condim", "margin"):
        if key in item:
            log.record(table, key, name, getattr(geom, key), item[key])
            setattr(geom, key, item[key])
    for key in ("friction", "solref", "solimp"):
        if key in item:
            given = item[key] if isinstance(item[key], list) else [item[key]]
            before = np.array(getattr(geom, key), dtype=float)
            after = before.copy()
            after[: len(given)] = given
            log.record(table, key, name, before, after)
            setattr(geom, key, after.tolist())


def _named_joints(spec: mujoco.MjSpec) -> list[tuple[str, Any]]:
    return [(joint.name or joint.parent.name, joint) for joint in spec.joints]


def _named_actuators(spec: mujoco.MjSpec) -> list[tuple[str, Any]]:
    return [(actuator.name or actuator.target, actuator) for actuator in spec.actuators]


def _named_geoms(spec: mujoco.MjSpec) -> list[tuple[str, Any]]:
    return [(geom.name or geom.parent.name, geom) for geom in spec.geoms]


class _Kind(NamedTuple):
    """How parts of a kind are found and changed."""

    named: Callable[[mujoco.MjSpec], list[tuple[str, Any]]]
    """Returns all of them, with the names by which they are selected."""
    override: Callable[[str, Item, str, Any, EditLog], None]


_KINDS = {
    "joints": _Kind(_named_joints, _override_joint),
    "actuators": _Kind(_named_actuators, _override_actuator),
    "geoms": _Kind(_named_geoms, _override_geom),
}
