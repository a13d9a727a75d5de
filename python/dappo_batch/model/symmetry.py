"""Left-right symmetry of a compiled robot: which of its parts are mirror images of each other.

The mirror is the plane y = 0 through the root in the default pose. Bodies are matched from the root outwards
by mass, place and joints.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, TypeAlias

import mujoco
import numpy as np

from dappo_batch._core import ConfigError
from dappo_batch.model.anatomy import default_pose
from dappo_batch.model.mujoco_library import quiet_mujoco
from dappo_batch.model.robot_spec import read_robot_spec

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from dappo_batch.model.class_table import ClassTable

    Vector: TypeAlias = NDArray[np.float64]

__all__ = ["Image", "Symmetry", "asymmetry", "find_symmetry", "mirror_images"]

_MIRROR = np.array([1.0, -1.0, 1.0])
"""Factors of a vector; those of an axial vector, such as the axis of a hinge, are their negatives."""
_PLACE = 0.02
"""By how much the places of mirror images may differ, as a share of the robot's extent."""
_MASS = 0.05
"""The same for masses and the constants of actuators, as a share of the larger one."""
_ANGLE = 0.01
"""The same for angles, rad, and for the entries of unit vectors."""


@dataclass(frozen=True)
class Image:
    """Index of the part that one is the mirror image of, and the sign that its coordinate then has."""

    of: int
    sign: float


@dataclass(frozen=True)
class Symmetry:
    """Of each limb, body, joint after the free one, and actuator, the part whose mirror image it is."""

    limbs: list[int]
    bodies: list[int]
    joints: list[Image]
    actuators: list[Image]


def find_symmetry(table: ClassTable) -> Symmetry:
    """Find out which parts of a robot are mirror images of each other.

    Raises
    ------
    ConfigError
        If a part has no mirror image.
    """
    try:
        return _search(table)
    except _Asymmetry as difference:
        raise ConfigError(
            f"robot {table.robot.name}: left and right are not mirror images: {difference}"
        ) from None


def mirror_images(table: ClassTable) -> list[int]:
    """Return the id of the damage class that each one is the mirror image of, [D].

    Raises
    ------
    ConfigError
        If the robot is not its own mirror image.
    """
    limbs = find_symmetry(table).limbs
    return [table.space.mirror_image(item.id, limbs) for item in table.space.classes]


def asymmetry(table: ClassTable) -> str | None:
    """Return what differs between left and right of a robot, or None if nothing does."""
    try:
        _search(table)
    except _Asymmetry as difference:
        return str(difference)
    return None


def _search(table: ClassTable) -> Symmetry:
    # The robot as its MJCF describes it: in variants of it centres of mass may lie to one side.
    with quiet_mujoco():
        spec, _ = read_robot_spec(table.robot)
        model = spec.compile()
    return _Mirror(model, default_pose(table.robot, model)).symmetry(table)


class _Asymmetry(Exception):
    """What differs between left and right."""


class _Mirror:
    """A model in its default pose, with the root at the origin."""

    def __init__(self, model: mujoco.MjModel, pose: Sequence[float]) -> None:
        self.model, self.data, self.pose = model, mujoco.MjData(model), pose
        if not model.njnt or int(model.jnt_type[0]) != int(mujoco.mjtJoint.mjJNT_FREE):
            raise _Asymmetry("the root has no free joint")
        single = (int(mujoco.mjtJoint.mjJNT_HINGE), int(mujoco.mjtJoint.mjJNT_SLIDE))
        if any(int(kind) not in single for kind in model.jnt_type[1:]):
            raise _Asymmetry("it has joints other than hinges and slides")
        self.data.qpos[:] = pose
        self.data.qpos[:3] = 0
        mujoco.mj_kinematics(model, self.data)
        self.root = int(model.jnt_bodyid[0])
        self._check_surroundings()
        of_robot = model.body_rootid == self.root
        self.extent = float(np.abs(self.data.xipos[of_robot]).max())

    def symmetry(self, table: ClassTable) -> Symmetry:
        rotation = self.data.xmat[self.root].reshape(3, 3)
        if not np.allclose(rotation * np.outer(_MIRROR, _MIRROR), rotation, atol=_ANGLE):
            raise _Asymmetry("the root is turned or rolled in the default pose")
        bodies = self._bodies()
        joints = self._joints(bodies)
        return Symmetry(
            limbs=_limbs(table, bodies),
            bodies=bodies,
            joints=[Image(joints[joint].of - 1, joints[joint].sign) for joint in range(1, self.model.njnt)],
            actuators=self._actuators(joints),
        )

    def _check_surroundings(self) -> None:
        """Accept floors along y alone besides the robot, and gravity that does not point to a side."""
        model = self.model
        others = [body for body in range(1, model.nbody) if int(model.body_rootid[body]) != self.root]
        if others:
            raise _Asymmetry(f"body {self._body(others[0])} does not belong to the robot")
        paired = {*model.pair_geom1.tolist(), *model.pair_geom2.tolist()}
        for geom in range(model.body_geomnum[0]):
            normal = self.data.geom_xmat[geom].reshape(3, 3)[:, 2]
            is_floor = (
                int(model.geom_type[geom]) == int(mujoco.mjtGeom.mjGEOM_PLANE) and abs(normal[1]) < _ANGLE
            )
            touches = model.geom_contype[geom] or model.geom_conaffinity[geom] or geom in paired
            if touches and not is_floor:
                raise _Asymmetry(f"the world has the geom {model.geom(geom).name or geom} besides floors")
        if model.opt.gravity[1] or model.opt.wind[1]:
            raise _Asymmetry("gravity or wind point to a side")

    def _bodies(self) -> list[int]:
        """Match bodies from the root outwards."""
        images = list(range(self.model.nbody))
        if not self._are_images(self.root, self.root):
            raise _Asymmetry(f"body {self._body(self.root)} has its centre of mass to one side")
        pairs = [(self.root, self.root)]
        while pairs:
            body, image = pairs.pop()
            images[body] = image
            left, right = self._children(body), self._children(image)
            for child in left:
                match = min(right, key=lambda other: self._distance(child, other), default=None)
                if match is None or not self._are_images(child, match):
                    raise _Asymmetry(f"body {self._body(child)} has no mirror image")
                right.remove(match)
                pairs.append((child, match))
        return images

    def _children(self, body: int) -> list[int]:
        return [child for child in range(1, self.model.nbody) if int(self.model.body_parentid[child]) == body]

    def _distance(self, body: int, image: int) -> float:
        """Return how far the frame and the centre of mass of a body lie from their mirror images, m."""
        frames = np.linalg.norm(self.data.xpos[body] * _MIRROR - self.data.xpos[image])
        centers = np.linalg.norm(self.data.xipos[body] * _MIRROR - self.data.xipos[image])
        return float(frames + centers)

    def _are_images(self, body: int, image: int) -> bool:
        masses = self.model.body_mass[[body, image]]
        return bool(
            self._distance(body, image) <= 2 * _PLACE * self.extent
            and masses.max() - masses.min() <= _MASS * masses.max()
            and self.model.body_jntnum[body] == self.model.body_jntnum[image]
        )

    def _joints(self, bodies: Sequence[int]) -> dict[int, Image]:
        images = {0: Image(0, 1.0)}
        for joint in range(1, self.model.njnt):
            body = int(self.model.jnt_bodyid[joint])
            place = joint - int(self.model.body_jntadr[body])
            image = int(self.model.body_jntadr[bodies[body]]) + place
            images[joint] = Image(image, self._sign(joint, image))
        return images

    def _sign(self, joint: int, image: int) -> float:
        """Return the sign that the position of a joint has in the mirror image of another one."""
        model, data, names = self.model, self.data, f"joint {self._joint(joint)} and {self._joint(image)}"
        kind = int(model.jnt_type[joint])
        is_hinge = kind == int(mujoco.mjtJoint.mjJNT_HINGE)
        mirrored = data.xaxis[image] * (-_MIRROR if is_hinge else _MIRROR)
        cosine = float(mirrored @ data.xaxis[joint])
        apart = np.linalg.norm(data.xanchor[image] * _MIRROR - data.xanchor[joint])
        if kind != int(model.jnt_type[image]) or abs(cosine) < 1 - _ANGLE or apart > _PLACE * self.extent:
            raise _Asymmetry(f"{names} have different axes")
        sign = 1.0 if cosine > 0 else -1.0
        if not np.allclose(self._limits(image, sign), self._limits(joint, 1.0), rtol=0, atol=_ANGLE):
            raise _Asymmetry(f"{names} have different ranges")
        position, other = (self.pose[int(model.jnt_qposadr[it])] for it in (joint, image))
        if abs(position - sign * other) > _ANGLE:
            raise _Asymmetry(f"{names} have different positions in the default pose")
        return sign

    def _limits(self, joint: int, sign: float) -> Vector:
        limits = self.model.jnt_range[joint] if self.model.jnt_limited[joint] else np.array([-np.inf, np.inf])
        return np.sort(sign * limits)

    def _actuators(self, joints: dict[int, Image]) -> list[Image]:
        model = self.model
        of_joint: dict[int, list[int]] = {}
        for index in range(model.nu):
            if int(model.actuator_trntype[index]) != int(mujoco.mjtTrn.mjTRN_JOINT):
                raise _Asymmetry(f"actuator {self._actuator(index)} moves something other than a joint")
            of_joint.setdefault(int(model.actuator_trnid[index, 0]), []).append(index)
        images = {}
        for joint, actuators in of_joint.items():
            image = joints[joint]
            others = of_joint.get(image.of, [])
            if len(others) != len(actuators):
                raise _Asymmetry(
                    f"joint {self._joint(joint)} has another number of actuators than its mirror image"
                )
            for actuator, other in zip(actuators, others, strict=True):
                images[actuator] = self._actuator_image(actuator, other, image.sign)
        return [images[index] for index in range(model.nu)]

    def _actuator_image(self, actuator: int, other: int, sign: float) -> Image:
        model = self.model
        gears = model.actuator_gear[[actuator, other], 0]
        if gears[0] * gears[1] < 0:
            sign = -sign
        if not np.allclose(
            self._constants(actuator, 1.0), self._constants(other, sign), rtol=_MASS, atol=1e-6
        ):
            raise _Asymmetry(f"actuators {self._actuator(actuator)} and {self._actuator(other)} differ")
        return Image(other, sign)

    def _constants(self, actuator: int, sign: float) -> Vector:
        """Return the constants of an actuator, with the range of its control times a sign."""
        model = self.model
        return np.concatenate(
            [
                np.abs(model.actuator_gear[actuator, :1]),
                model.actuator_gainprm[actuator, :3],
                model.actuator_biasprm[actuator, :3],
                model.actuator_ctrllimited[[actuator]],
                np.sort(sign * model.actuator_ctrlrange[actuator]),
            ]
        )

    def _body(self, index: int) -> str:
        return str(self.model.body(index).name or index)

    def _joint(self, index: int) -> str:
        return str(self.model.joint(index).name or index)

    def _actuator(self, index: int) -> str:
        return str(self.model.actuator(index).name or index)


def _limbs(table: ClassTable, bodies: Sequence[int]) -> list[int]:
    limbs = [sorted(limb) for limb in table.limb_bodies]
    images = []
    for limb, parts in zip(table.robot.limbs, limbs, strict=True):
        mirrored = sorted(bodies[body] for body in parts)
        if mirrored not in limbs:
            raise _Asymmetry(f"the mirror image of limb {limb.name} is no limb")
        images.append(limbs.index(mirrored))
    return images
