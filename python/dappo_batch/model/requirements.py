"""Requirements of a compiled robot for every backend.

The list is that of the guide: `docs/guides/robots-and-damage.md`, *A robot of your own*.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from dappo_batch.model.anatomy import default_pose, foot_faults
from dappo_batch.robots.faults import raise_faults

if TYPE_CHECKING:
    from dappo_batch.robots import Limb, Robot

__all__ = ["Parts", "find_parts"]

_ANY_HEIGHT = (-float("inf"), float("inf"))
_LONGEST_STEP = 10.0
"""Maximum duration of an env step, s."""
_LARGEST = float(np.finfo(np.float32).max)
"""The largest number in single precision."""

# Arrays of a model that the physics depends on. Bounding boxes of planes are large on purpose.
_PHYSICAL = (
    "qpos",
    "body_",
    "jnt_",
    "dof_",
    "geom_",
    "site_",
    "tendon_",
    "actuator_",
    "pair_",
    "eq_",
    "hfield_size",
)
_NOT_PHYSICAL = ("_user", "_rgba", "_aabb", "_rbound")

_BODY = mujoco.mjtObj.mjOBJ_BODY
_JOINT = mujoco.mjtObj.mjOBJ_JOINT
_GEOM = mujoco.mjtObj.mjOBJ_GEOM
_SITE = mujoco.mjtObj.mjOBJ_SITE
_SENSOR = mujoco.mjtObj.mjOBJ_SENSOR
_CAMERA = mujoco.mjtObj.mjOBJ_CAMERA

_DIVERGED = (
    mujoco.mjtWarning.mjWARN_BADQPOS,
    mujoco.mjtWarning.mjWARN_BADQVEL,
    mujoco.mjtWarning.mjWARN_BADQACC,
)


@dataclass(frozen=True)
class Parts:
    """Indices in the compiled model of the parts in a robot TOML."""

    limb_bodies: tuple[tuple[int, ...], ...]
    """Per limb, the ids of its bodies."""
    touch_addresses: tuple[int, ...]
    """Per limb, the index of its touch signal in ``sensordata``; empty if the robot has no touch sensors."""
    main_body: int
    """Id of the body whose x position defines the forward velocity."""


def find_parts(robot: Robot, model: mujoco.MjModel) -> Parts:
    """Find the parts of a robot in its healthy model, and check the requirements.

    Raises
    ------
    ConfigError
        If a requirement is not met, with all faults.
    """
    search = _Search(robot, model)
    limb_bodies = search.limb_bodies()
    touch_addresses = search.touch_addresses(limb_bodies)
    main_body = search.find(_BODY, robot.main_body, "main_body")
    search.check_root(main_body, limb_bodies)
    search.check_camera()
    search.faults += foot_faults(robot, model, limb_bodies)
    search.check_numbers()
    if not search.faults:
        search.check_start()
    raise_faults(f"robot {robot.name}", search.faults)
    return Parts(
        limb_bodies=tuple(map(tuple, limb_bodies)),
        touch_addresses=tuple(touch_addresses),
        main_body=main_body,
    )


class _Search:
    """Finds parts, and collects faults."""

    def __init__(self, robot: Robot, model: mujoco.MjModel) -> None:
        self.robot = robot
        self.model = model
        self.faults: list[str] = []

    def find(self, kind: mujoco.mjtObj, name: str, what: str) -> int:
        """Return an id, or -1 with a fault."""
        index = int(mujoco.mj_name2id(self.model, kind, name))
        if index < 0:
            self.faults.append(f"{what}: the MJCF has no {kind.name.removeprefix('mjOBJ_').lower()} {name!r}")
        return index

    def limb_bodies(self) -> list[list[int]]:
        """Return the bodies of each limb, and check that its joints and its toe belong to them."""
        owner: dict[int, Limb] = {}
        limbs: list[list[int]] = []
        for limb in self.robot.limbs:
            what = f"limb {limb.name}"
            first = self.find(_BODY, limb.body, what)
            bodies = [] if first < 0 else _subtree(self.model, first)
            limbs.append(bodies)
            for body in bodies:
                if body in owner:
                    name = self.model.body(body).name
                    self.faults.append(f"{what}: body {name} belongs to limb {owner[body].name} already")
                    break
                owner[body] = limb
            self._check_limb(limb, what, bodies)
        return limbs

    def _check_limb(self, limb: Limb, what: str, bodies: list[int]) -> None:
        parts = [(name, self.model.jnt_bodyid, _JOINT) for name in limb.joints]
        if limb.toe_geom is not None:
            parts.append((limb.toe_geom, self.model.geom_bodyid, _GEOM))
        if limb.touch_site is not None:
            parts.append((limb.touch_site, self.model.site_bodyid, _SITE))
        joint_bodies = []
        for name, body_ids, kind in parts:
            index = self.find(kind, name, what)
            if index < 0 or not bodies:
                continue
            if int(body_ids[index]) not in bodies:
                self.faults.append(f"{what}: {name} is not part of body {limb.body} or of a body below it")
            elif kind == _JOINT:
                joint_bodies.append((int(body_ids[index]), name))
        for (inner, first), (outer, second) in pairwise(joint_bodies):
            if outer not in _subtree(self.model, inner):
                self.faults.append(
                    f"{what}: joints go from the torso outwards, but {second} does not hang on {first}"
                )

    def touch_addresses(self, limb_bodies: list[list[int]]) -> list[int]:
        addresses = []
        for limb, bodies in zip(self.robot.limbs, limb_bodies, strict=True):
            if limb.touch is None:
                continue
            index = self.find(_SENSOR, limb.touch, f"limb {limb.name}: touch")
            if index < 0:
                continue
            if self.model.sensor_type[index] != mujoco.mjtSensor.mjSENS_TOUCH:
                self.faults.append(f"limb {limb.name}: sensor {limb.touch} is not a touch sensor")
            elif bodies and int(self.model.site_bodyid[self.model.sensor_objid[index]]) not in bodies:
                self.faults.append(
                    f"limb {limb.name}: the site of sensor {limb.touch} lies on no body of the limb"
                )
            addresses.append(int(self.model.sensor_adr[index]))
        return addresses

    def check_root(self, main_body: int, limb_bodies: list[list[int]]) -> None:
        """Check the free joint, the bodies below it, and the actuators."""
        model = self.model
        if model.nu == 0:
            self.faults.append("it has no actuators, so no action can move it; add an <actuator> to the MJCF")
        if model.njnt == 0 or model.jnt_type[0] != mujoco.mjtJoint.mjJNT_FREE:
            first = "there is none" if model.njnt == 0 else f"the first joint is {_joint_name(model, 0)}"
            self.faults.append(
                "its first joint must be a free joint, because the height is read from qpos[2] and the"
                f" forward velocity from the x of the world; {first}"
            )
            return
        root = int(model.jnt_bodyid[0])
        name = model.body(root).name
        if main_body >= 0 and main_body not in _subtree(model, root):
            self.faults.append(
                f"main_body {self.robot.main_body} is not the body of the first free joint, {name}, or"
                " below it;"
                " list the robot before everything else that moves freely"
            )
        for limb, bodies in zip(self.robot.limbs, limb_bodies, strict=True):
            if bodies and (bodies[0] == root or bodies[0] not in _subtree(model, root)):
                self.faults.append(
                    f"limb {limb.name}: body {limb.body} does not hang on the free body {name}"
                )

    def check_camera(self) -> None:
        """Check the camera, which is not used before the first picture."""
        name = self.robot.spec.get("pictures", {}).get("camera")
        if name is None or mujoco.mj_name2id(self.model, _CAMERA, name) >= 0:
            return
        cameras = [
            repr(found) for index in range(self.model.ncam) if (found := self.model.camera(index).name)
        ]
        named = f"expected one of {', '.join(cameras)}" if cameras else "it has none with a name"
        self.faults.append(
            f"[pictures] camera: the MJCF has no camera {name!r}; {named}, or leave the entry out for"
            " the default camera"
        )

    def check_numbers(self) -> None:
        """Check that the numbers of the model are finite, and the duration of an env step."""
        model = self.model
        timestep, frame_skip = float(model.opt.timestep), int(self.robot.spec["frame_skip"])
        if not 0.0 < timestep * frame_skip <= _LONGEST_STEP:
            self.faults.append(
                f"an env step of frame_skip = {frame_skip} times the timestep, {timestep} s, must last"
                " more than 0"
                f" and at most {_LONGEST_STEP} s"
            )
        for name in dir(model):
            if name.startswith(_PHYSICAL) and not name.endswith(_NOT_PHYSICAL):
                self._check_array(name, np.asarray(getattr(model, name)))
        for name in dir(model.opt):
            if not name.startswith("_"):
                self._check_array(f"opt.{name}", np.asarray(getattr(model.opt, name)))
        observation = self.robot.spec["observation"]
        for index, term in enumerate(observation.get("policy", observation)["terms"]):
            if term["term"] == "qpos" and term.get("skip", 0) >= model.nq:
                self.faults.append(
                    f"[observation] term {index}: qpos skips {term['skip']} of {model.nq} positions;"
                    " expected fewer"
                )

    def _check_array(self, name: str, values: np.ndarray) -> None:
        if values.dtype.kind != "f":
            return
        # A range may have an infinite end.
        is_range = name.endswith("range")
        bad = np.isnan(values) if is_range else ~(np.abs(values) <= _LARGEST)
        if bad.any():
            place = tuple(int(index) for index in np.argwhere(bad)[0])
            self.faults.append(
                f"{name}{list(place) if place else ''} is {values[place]} in the compiled MJCF; expected a"
                " finite number up to"
                f" {_LARGEST:g}"
            )

    def check_start(self) -> None:
        """Check the initial pose of episodes, and that the physics of the first env step does not diverge."""
        model, spec = self.model, self.robot.spec
        limits = spec.get("terminations", spec.get("termination", {}))
        (low, high), noise = limits.get("height", _ANY_HEIGHT), spec["reset"]["qpos_noise"]
        start = default_pose(self.robot, model)
        height = start[2]
        if not low <= height - noise <= height + noise <= high:
            self.faults.append(
                f"episodes begin at a height of {height:.6g} m, plus or minus the qpos_noise of {noise:g},"
                " and"
                f" [termination] height = [{low:g}, {high:g}] does not hold all of it; widen that range,"
                " or change"
                " the height of the free body in the MJCF"
            )
        data = mujoco.MjData(model)
        data.qpos[:] = start
        mujoco.mj_step(model, data, nstep=int(spec["frame_skip"]))
        if any(data.warning.number[int(warning)] for warning in _DIVERGED):
            self.faults.append(
                "its physics diverges in the first env step, without any action; shorten the timestep, or"
                " look for"
                " parts that overlap and for joints outside their range"
            )


def _subtree(model: mujoco.MjModel, root: int) -> list[int]:
    """Return a body and all bodies below it."""
    inside = {root}
    # Parents have smaller ids, so one pass in the order of ids is enough.
    for body in range(root + 1, model.nbody):
        if int(model.body_parentid[body]) in inside:
            inside.add(body)
    return sorted(inside)


def _joint_name(model: mujoco.MjModel, joint: int) -> str:
    kind = mujoco.mjtJoint(int(model.jnt_type[joint])).name.removeprefix("mjJNT_").lower()
    return f"{model.joint(joint).name or joint} ({kind})"
