"""``dappo-batch check``: what a robot is, and which backend and damage types it supports."""

from __future__ import annotations

from collections import Counter
from json import dumps
from os import PathLike
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from dappo_batch._checks import folder, integer, sequence, text
from dappo_batch.model import ClassTable, ClassTableError, compile_class_table, lanes
from dappo_batch.model.class_table import damage_refusals
from dappo_batch.model.mujoco_library import integrator_name
from dappo_batch.model.symmetry import asymmetry
from dappo_batch.results import ActuatorInfo, JointInfo, Reason, RobotReport
from dappo_batch.robots import Robot, load_robot

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

__all__ = ["check_robot", "command"]

_GAIN, _BIAS, _TRANSMISSION = mujoco.mjtGain, mujoco.mjtBias, mujoco.mjtTrn
_MOVED = {
    _TRANSMISSION.mjTRN_JOINT: mujoco.mjtObj.mjOBJ_JOINT,
    _TRANSMISSION.mjTRN_JOINTINPARENT: mujoco.mjtObj.mjOBJ_JOINT,
    _TRANSMISSION.mjTRN_TENDON: mujoco.mjtObj.mjOBJ_TENDON,
    _TRANSMISSION.mjTRN_SITE: mujoco.mjtObj.mjOBJ_SITE,
    _TRANSMISSION.mjTRN_BODY: mujoco.mjtObj.mjOBJ_BODY,
}


def check_robot(
    robot: Robot | str | Path,
    *,
    types: Sequence[str] | None = None,
    max_damaged_limbs: int | None = None,
    max_damages_per_limb: int | None = None,
    picture: str | bytes | PathLike[str] | None = None,
) -> RobotReport:
    """Compile all damage classes of a robot, and report what it is and what supports it.

    Parameters
    ----------
    robot
        A robot, a robot's name, or the path of a robot TOML.
    types
        Names of damage types; by default those of the robot TOML.
    max_damaged_limbs
        Maximum number of damaged limbs; by default that of the robot TOML.
    max_damages_per_limb
        Maximum number of damages of a limb; by default that of the robot TOML.
    picture
        A PNG file to write, with a tile for each damage class, at most 36.

    Returns
    -------
    RobotReport
        The report. Damage types that cannot be applied are in its `refusals`, and the rest is reported
        without them.

    Raises
    ------
    ConfigError
        If the robot cannot be compiled without damage, with all faults, or `picture` cannot be written there.
    MissingExtraError, RenderError
        If `picture` is given and rendering is not possible.
    """
    if not isinstance(robot, Robot):
        robot = load_robot(folder(robot, "robot") if isinstance(robot, PathLike) else text(robot, "robot"))
    target = None
    if picture is not None:
        # Rendering is imported only where it is used.
        from dappo_batch.render import tiles

        target = tiles.check(picture)
    names = robot.damage_types if types is None else sequence(types, "types")
    names = [text(name, "a damage type") for name in names]
    limit = robot.max_damaged_limbs if max_damaged_limbs is None else max_damaged_limbs
    limit = integer(limit, "max_damaged_limbs", 0)
    table, refusals = _compile(robot, names, limit, max_damages_per_limb)
    if target is not None:
        tiles.write(target, table)
    return _report(table, refusals)


def _compile(
    robot: Robot, names: Sequence[str], limit: int, per_limb: int | None
) -> tuple[ClassTable, list[str]]:
    """Return the class table of all damage types that can be applied, and why others cannot."""
    refused = damage_refusals(robot, names) if limit else {}
    fit = [name for name in names if name not in refused]
    refusals = [fault for faults in refused.values() for fault in faults]
    if per_limb is not None:
        per_limb = min(integer(per_limb, "max_damages_per_limb", 1), max(len(fit), 1))
    try:
        table = compile_class_table(
            robot, types=fit, max_damaged_limbs=limit if fit else 0, max_damages_per_limb=per_limb
        )
        return table, refusals
    except ClassTableError as error:
        return compile_class_table(robot, types=fit, max_damaged_limbs=0), [*refusals, str(error)]


def _report(table: ClassTable, refusals: Sequence[str]) -> RobotReport:
    model, robot = table.models[0], table.robot
    of_robot = model.body_rootid == model.body_rootid[table.main_body]
    contacts, self_collision = _contacts(model, of_robot)
    reasons, notes = lanes.support(table)
    return RobotReport(
        robot=robot.name,
        mass=float(model.body_mass[of_robot].sum()),
        timestep=float(model.opt.timestep),
        frame_skip=int(robot.spec["frame_skip"]),
        integrator=integrator_name(table),
        cone=mujoco.mjtCone(model.opt.cone).name.removeprefix("mjCONE_").lower(),
        joints=tuple(
            _joint(model, joint)
            for joint in range(model.njnt)
            if model.jnt_type[joint] != mujoco.mjtJoint.mjJNT_FREE
        ),
        actuators=tuple(_actuator(model, actuator) for actuator in range(model.nu)),
        floor_contacts=tuple(_geom_name(model, geom) for geom in contacts),
        self_collision=self_collision,
        damage_classes=tuple(item.name for item in table.space.classes),
        variant_names=table.variants.names,
        variants=table.variants.numbers,
        models=len(table.all_models),
        model_bytes=table.nbytes,
        edits=table.edits,
        backend="mujoco" if reasons else "lanes",
        reasons=reasons,
        notes=notes,
        asymmetry=asymmetry(table),
        refusals=tuple(refusals),
    )


def _joint(model: mujoco.MjModel, joint: int) -> JointInfo:
    dof = int(model.jnt_dofadr[joint])
    kind = mujoco.mjtJoint(int(model.jnt_type[joint])).name.removeprefix("mjJNT_").lower()
    return JointInfo(
        name=model.joint(joint).name or model.body(int(model.jnt_bodyid[joint])).name,
        kind=kind,
        range=_range(model.jnt_limited[joint], model.jnt_range[joint]),
        damping=float(model.dof_damping[dof]),
        armature=float(model.dof_armature[dof]),
        frictionloss=float(model.dof_frictionloss[dof]),
        stiffness=float(model.jnt_stiffness[joint]),
    )


def _actuator(model: mujoco.MjModel, index: int) -> ActuatorInfo:
    gain = float(model.actuator_gainprm[index, 0])
    # The bias is a force; adding 0 removes the sign of a zero.
    kp, kd = (float(-number) + 0.0 for number in model.actuator_biasprm[index, 1:3])
    bias = model.actuator_biastype[index]
    control = "other"
    if model.actuator_gaintype[index] == _GAIN.mjGAIN_FIXED:
        if bias == _BIAS.mjBIAS_NONE:
            control = "torque"
        elif bias == _BIAS.mjBIAS_AFFINE and gain == (kp or kd):
            control = "position" if kp else "velocity"
    is_servo = control in ("position", "velocity")
    moved = _MOVED.get(_TRANSMISSION(int(model.actuator_trntype[index])))
    target = mujoco.mj_id2name(model, moved, int(model.actuator_trnid[index, 0])) if moved is not None else ""
    return ActuatorInfo(
        name=model.actuator(index).name or target or str(index),
        control=control,
        kp=kp if is_servo else 0.0,
        kd=kd if is_servo else 0.0,
        gear=float(model.actuator_gear[index, 0]),
        ctrl_range=_range(model.actuator_ctrllimited[index], model.actuator_ctrlrange[index]),
        force_range=_range(model.actuator_forcelimited[index], model.actuator_forcerange[index]),
    )


def _range(limited: int, bounds: NDArray[np.float64]) -> tuple[float, ...] | None:
    return tuple(float(bound) for bound in bounds) if limited else None


def _contacts(model: mujoco.MjModel, of_robot: NDArray[np.bool_]) -> tuple[list[int], bool]:
    """Return the geoms of the robot that can touch the world, and whether it can touch itself."""
    robot = of_robot[model.geom_bodyid]
    world = model.body_weldid[model.geom_bodyid] == 0
    one, other = model.pair_geom1, model.pair_geom2
    touching = {int(a) for a, b in zip([*one, *other], [*other, *one], strict=True) if robot[a] and world[b]}
    itself = bool((robot[one] & robot[other]).any())
    types, affinities = model.geom_contype, model.geom_conaffinity
    for geom in np.flatnonzero(robot & ((types | affinities) != 0)):
        matches = (types[geom] & affinities | types & affinities[geom]) != 0
        if (matches & world).any():
            touching.add(int(geom))
        # MuJoCo has no contacts within a body, and with its parent only where that is chosen.
        body = model.geom_bodyid[geom]
        near = np.isin(model.geom_bodyid, (body, model.body_parentid[body]))
        itself |= bool((matches & robot & ~near).any())
    return sorted(touching), itself


def _geom_name(model: mujoco.MjModel, geom: int) -> str:
    """Return the name of a geom; that of its body if it has none, or the one of an explicit pair."""
    name = model.geom(geom).name
    if name and name != f"geom {geom}":
        return str(name)
    return f"a geom of {model.body(int(model.geom_bodyid[geom])).name}"


def _text(report: RobotReport) -> str:
    step = report.timestep * report.frame_skip
    lines = [
        f"{report.robot}: {report.mass:.6g} kg, {len(report.joints)} joints, {len(report.actuators)}"
        f" actuators, {len(report.damage_classes)} damage classes",
        f"physics step {report.timestep:.6g} s, {report.frame_skip} in an env step of {step:.6g} s,"
        f" {report.integrator}, {report.cone} cones",
        "",
        *_table(
            ("joint", "kind", "range", "damping", "armature", "frictionloss", "stiffness"),
            (
                (j.name, j.kind, _bounds(j.range), j.damping, j.armature, j.frictionloss, j.stiffness)
                for j in report.joints
            ),
        ),
        "",
        *_table(
            ("actuator", "control", "kp", "kd", "gear", "ctrl_range", "force_range"),
            (
                (a.name, a.control, a.kp, a.kd, a.gear, _bounds(a.ctrl_range), _bounds(a.force_range))
                for a in report.actuators
            ),
        ),
        "",
        f"floor contacts: {_counted(report.floor_contacts) or 'none'}",
        f"self-collision: {'yes' if report.self_collision else 'no'}",
        f"left and right are mirror images: {_symmetry(report.asymmetry)}",
    ]
    if report.variants:
        lines += [
            "",
            f"{len(report.variants)} compiled variants of each damage class: {report.models} models,"
            f" {report.model_bytes / 1e6:.0f} MB",
            *_table(
                ("variant", *report.variant_names),
                ((str(index), *numbers) for index, numbers in enumerate(report.variants)),
            ),
        ]
    if report.edits:
        lines += ["", "changes of the MJCF", *(f"  {edit}" for edit in report.edits)]
    lines += ["", f"backend auto on the CPU: {report.backend}"]
    lines += [f"  not lanes: {_reason(reason)}" for reason in report.reasons]
    lines += [f"  note: {note}" for note in report.notes]
    if report.refusals:
        lines += ["", "damage that cannot be applied", *(f"  {refusal}" for refusal in report.refusals)]
    return "\n".join(lines)


def _symmetry(asymmetry: str | None) -> str:
    return "yes" if asymmetry is None else f"no, {asymmetry}"


def _counted(geoms: Sequence[str]) -> str:
    """Return names of geoms as a list, with the number of those without a name."""
    counts = Counter(geoms)
    names = (
        name if count == 1 else name.replace("a geom", f"{count} geoms", 1) for name, count in counts.items()
    )
    return ", ".join(names)


def _reason(reason: Reason) -> str:
    return f"{reason.text}; try {reason.remedy}" if reason.remedy else reason.text


def _bounds(bounds: tuple[float, ...] | None) -> str:
    return "none" if bounds is None else " to ".join(f"{bound:.6g}" for bound in bounds)


def _table(header: Sequence[str], rows: Iterable[Sequence[str | float]]) -> list[str]:
    """Return lines with columns; texts are aligned to the left, numbers to the right."""
    every = [tuple(header), *(tuple(map(_cell, row)) for row in rows)]
    widths = [max(map(len, column)) for column in zip(*every, strict=True)]
    lines = ("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) for row in every)
    return [line.rstrip() for line in lines]


def _cell(value: str | float) -> str:
    return value if isinstance(value, str) else f"{value:.6g}"


def command(
    *,
    robot: str,
    types: Sequence[str] | None,
    max_damaged_limbs: int | None,
    max_damages_per_limb: int | None,
    picture: Path | None,
    json: bool,
) -> int:
    """Run ``dappo-batch check`` and return its exit code: 1 if a damage type cannot be applied."""
    report = check_robot(
        robot,
        types=types,
        max_damaged_limbs=max_damaged_limbs,
        max_damages_per_limb=max_damages_per_limb,
        picture=picture,
    )
    print(dumps(report.to_dict(), indent=2) if json else _text(report))
    if picture is not None and not json:
        from dappo_batch.render import tiles

        drawn = min(tiles.MOST, len(report.damage_classes))
        print(f"\n{picture}: {drawn} of {len(report.damage_classes)} damage classes")
    return 1 if report.refusals else 0
