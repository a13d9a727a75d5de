"""The lane engine compared with MuJoCo on random robots, whose frames are never the identity."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import mujoco
import numpy as np
import pytest
from numpy.typing import ArrayLike

from dappo_batch import ClassTable, compile_class_table
from dappo_batch._core import LaneWorlds

from .states import States, advance, converged, evaluate, relative_error

SHAPES = [(3, 2), (4, 2), (4, 3), (6, 3), (2, 6), (5, 7)]
"""Limbs and joints of a limb that the engine is compiled for."""
INTEGRATORS = ["RK4", "Euler", "implicitfast"]
FEATURES = [
    "actuator range",
    "condim",
    "dry friction",
    "elliptic",
    "explicit damping",
    "free joint",
    "gravity compensation",
    "gravity on a slope",
    "hinges of one body",
    "impratio",
    "shapes",
    "softness",
    "springs",
    "trunk",
    "unequal limbs",
    "unread sensors",
]
"""What a robot may have besides limbs, limits and contacts."""
ROBOTS = 4
"""Robots of each shape and integrator, and of each feature and integrator."""
COMBINATIONS = 12
"""Robots of each integrator with any features."""
WORLDS = 21
"""Neither a multiple of the lanes of a register nor fewer than two registers."""
SIZES = {
    "sphere": [0.05],
    "capsule": [0.03, 0.06],
    "box": [0.05, 0.03, 0.04],
    "cylinder": [0.05, 0.03],
    "ellipsoid": [0.05, 0.03, 0.04],
}
SOFTNESSES = [
    {"solref": "0.02 1", "solimp": "0.9 0.95 0.001 0.5 2"},
    {"solref": "0.05 0.7", "solimp": "0.5 0.95 0.02 0.3 2"},
    {"solref": "-900 -30", "solimp": "0.8 0.8 0.01 0.5 1"},
    {"solref": "0.03 1.2", "solimp": "0.2 0.9 0.05 0.6 4"},
]
LIMB = """
[[limbs]]
name = "limb_{limb}"
body = "{body}"
joints = ["joint_{limb}_0"]
toe_geom = "{toe}"
touch = "touch_{limb}"
touch_site = "site_{limb}"
"""
ROBOT = """
name = "random"
mjcf = "random.xml"
main_body = "root"
frame_skip = 1
max_episode_steps = 100
action_scale = 1.0
{limbs}
[damage]
types = ["jammed_joint"]
max_damaged_limbs = 0
[damage.jammed_joint]
joint = 0
range_deg = 1.0
[reset]
qpos_noise = 0.0
qvel_noise = 0.0
[termination]
height = [-5.0, 5.0]
[observation]
terms = [{{ term = "qpos" }}]
[reward]
default = "paper"
[reward.paper]
terms = [{{ term = "forward_velocity", weight = 1.0 }}]
"""


def _add(parent: Element, tag: str, **attributes: str | ArrayLike) -> Element:
    """Add an element; numbers and arrays become text."""
    texts = {
        name: value if isinstance(value, str) else " ".join(f"{number:.9g}" for number in np.ravel(value))
        for name, value in attributes.items()
    }
    return ElementTree.SubElement(parent, tag, texts)


class _RandomRobot:
    """Writes one robot, every number of which is drawn."""

    def __init__(
        self,
        rng: np.random.Generator,
        lengths: list[int],
        integrator: str,
        features: Collection[str] = (),
    ) -> None:
        self.rng = rng
        self.features = features
        self.mjcf = Element("mujoco")
        _add(self.mjcf, "compiler", angle="radian")
        option = _add(
            self.mjcf,
            "option",
            timestep=rng.uniform(0.001, 0.005),
            integrator=integrator,
            gravity=[0, 0, -rng.uniform(5, 12)],
        )
        if "elliptic" in features:
            option.set("cone", "elliptic")
        if "gravity on a slope" in features:
            option.set("gravity", " ".join(map(str, rng.uniform([-4, -4, -12], [4, 4, -5]))))
        if "impratio" in features:
            option.set("impratio", f"{rng.choice([0.3, 5.0, 100.0])}")
        if "explicit damping" in features:
            _add(option, "flag", eulerdamp="disable")
        default = _add(self.mjcf, "default")
        margin = rng.choice([0.0, 0.005])
        _add(default, "geom", conaffinity="0", margin=margin, **SOFTNESSES[rng.integers(3)])
        limits = SOFTNESSES[rng.integers(3)]
        _add(default, "joint", solreflimit=limits["solref"], solimplimit=limits["solimp"])
        world = _add(self.mjcf, "worldbody")
        self.actuators = Element("actuator")
        self.sensors = _add(self.mjcf, "sensor")
        floor = [0, 0, rng.uniform(-0.2, 0.2)]
        _add(world, "geom", type="plane", size=[5, 5, 1], conaffinity="1", pos=floor, friction=[0.3, 0, 0])
        root = self.body(world, "root", 0.0)
        root.set("pos", f"0 0 {floor[2] + 0.4}")
        free = _add(root, "joint", type="free")
        if "free joint" in features:
            free.set("armature", f"{rng.uniform(0, 0.5)}")
            free.set("damping", f"{rng.uniform(0, 2)}")
        self.geom(root, "geom_root")
        self.geom(self.body(root, "load", 0.1), "geom_load")
        self.links: dict[tuple[int, int], Element] = {}
        limbs = [
            self.limb(self.carrier(root, limb, lengths), limb, joints) for limb, joints in enumerate(lengths)
        ]
        # What a limb of the robot TOML carries is a part of it, so that a trunk is none.
        self.toml = ROBOT.format(limbs="".join(limbs[1:] if "trunk" in features else limbs))
        if "unread sensors" in features:
            _add(root, "site", name="imu")
            _add(self.sensors, "gyro", site="imu", cutoff="0.5")
            _add(self.sensors, "framepos", objtype="body", objname="root")
        # Actuators in any order, so that none has the index of its joint.
        shuffled = rng.permutation(len(self.actuators))
        _add(self.mjcf, "actuator").extend(self.actuators[index] for index in shuffled)

    def body(self, parent: Element, name: str, reach: float) -> Element:
        body = _add(
            parent, "body", name=name, pos=self.rng.uniform(-reach, reach, 3), quat=self.rng.normal(size=4)
        )
        if "gravity compensation" in self.features and self.rng.random() < 0.7:
            body.set("gravcomp", f"{self.rng.uniform(0, 1.5)}")
        return body

    def geom(self, body: Element, name: str) -> None:
        rng = self.rng
        kind = rng.choice(list(SIZES)[: 5 if "shapes" in self.features else 3])
        geom = _add(
            body,
            "geom",
            name=name,
            type=str(kind),
            size=SIZES[kind],
            pos=rng.uniform(-0.05, 0.05, 3),
            quat=rng.normal(size=4),
            mass=rng.uniform(0.1, 0.5),
            friction=[rng.uniform(0.1, 1.5), 0.005, 0.0001],
        )
        if "condim" in self.features:
            geom.set("priority", "1")
            geom.set("condim", f"{rng.choice([1, 3, 4, 6])}")
            geom.set("friction", f"{rng.uniform(0.1, 1.5)} {rng.uniform(0, 0.1)} {rng.uniform(0, 0.05)}")
        if "softness" in self.features:
            # The geom's own and not a mixture with the floor's, which would have powers in between.
            geom.set("priority", "1")
            for key, value in SOFTNESSES[rng.integers(4)].items():
                geom.set(key, value)

    def carrier(self, root: Element, limb: int, lengths: list[int]) -> Element:
        """Return what a limb hangs on: the root, or the first limb where it is a trunk."""
        if "trunk" not in self.features or limb == 0:
            return root
        last = lengths[0] - 1
        # Two limbs at its end, so that it is not a part of one of them.
        link = last if limb < 3 else int(self.rng.integers(-1, last + 1))
        return root if link < 0 else self.links[0, link]

    def limb(self, carrier: Element, limb: int, joints: int) -> str:
        """Add a limb, on a mount of its own or on its carrier; return its section of the robot TOML."""
        first, body = f"link_{limb}_0", carrier
        if self.rng.random() < 0.4:
            first = f"mount_{limb}"
            body = self.body(carrier, first, 0.2)
            self.geom(body, f"geom_mount_{limb}")
        geom = ""
        for joint in range(joints):
            if joint > 0 and "hinges of one body" in self.features and self.rng.random() < 0.5:
                self.links[limb, joint] = body
                self.hinge(body, f"joint_{limb}_{joint}")
                continue
            body = self.links[limb, joint] = self.body(body, f"link_{limb}_{joint}", 0.15)
            self.hinge(body, f"joint_{limb}_{joint}")
            geom = f"geom_{limb}_{joint}"
            self.geom(body, geom)
            if self.rng.random() < 0.3:
                self.geom(self.body(body, f"load_{limb}_{joint}", 0.1), f"geom_load_{limb}_{joint}")
        _add(body, "site", name=f"site_{limb}", type="sphere", size=0.3)
        _add(self.sensors, "touch", name=f"touch_{limb}", site=f"site_{limb}")
        return LIMB.format(limb=limb, body=first, toe=geom)

    def hinge(self, body: Element, name: str) -> None:
        """Add a hinge, mostly with limits, and mostly with a motor or a servo."""
        rng = self.rng
        ref = rng.uniform(-0.3, 0.3)
        joint = _add(
            body,
            "joint",
            name=name,
            axis=rng.normal(size=3),
            pos=rng.uniform(-0.05, 0.05, 3),
            ref=ref,
            armature=rng.uniform(0, 0.1),
            damping=rng.uniform(0, 1),
        )
        if rng.random() < 0.7:
            low, high = ref - rng.uniform(0.05, 0.5), ref + rng.uniform(0.05, 0.5)
            joint.set("range", f"{low} {high}")
            joint.set("margin", str(rng.choice([0.0, 0.01])))
        if "softness" in self.features:
            limit, friction = (SOFTNESSES[index] for index in rng.integers(4, size=2))
            joint.set("solreflimit", limit["solref"])
            joint.set("solimplimit", limit["solimp"])
            joint.set("solreffriction", friction["solref"])
            joint.set("solimpfriction", friction["solimp"])
        if "dry friction" in self.features and rng.random() < 0.8:
            joint.set("frictionloss", f"{rng.uniform(0.01, 1)}")
        if "springs" in self.features and rng.random() < 0.8:
            joint.set("stiffness", f"{rng.uniform(0, 20)}")
            joint.set("springref", f"{rng.uniform(-0.5, 0.5)}")
        if "actuator range" in self.features and rng.random() < 0.8:
            joint.set("actuatorfrcrange", f"{rng.uniform(-2, 0)} {rng.uniform(0, 1)}")
        match rng.choice(["motor", "servo", "none"], p=[0.4, 0.4, 0.2]):
            case "motor":
                gear = rng.choice([-1, 1]) * rng.uniform(1, 5)
                _add(self.actuators, "motor", joint=name, gear=gear, ctrlrange=[-0.5, 0.6])
            case "servo":
                kv = rng.choice([0.0, 1.0])
                gear = rng.uniform(0.5, 2)
                _add(self.actuators, "position", joint=name, kp=20, kv=kv, gear=gear, forcerange=[-3, 2])

    def compile(self, folder: Path) -> ClassTable:
        (folder / "random.xml").write_bytes(ElementTree.tostring(self.mjcf))
        (folder / "random.toml").write_text(self.toml)
        return compile_class_table(folder / "random.toml")


def _states(model: mujoco.MjModel, rng: np.random.Generator) -> States:
    """Return states in any orientation, from deep in the floor to just above it, within and beyond limits."""
    qpos = np.tile(model.qpos0, (WORLDS, 1))
    qpos[:, 2] += rng.uniform(-0.6, 0.1, WORLDS)
    qpos[:, 3:7] = rng.normal(size=(WORLDS, 4))
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    qpos[:, 7:] += rng.uniform(-0.6, 0.6, (WORLDS, model.nq - 7))
    return States(qpos, rng.normal(size=(WORLDS, model.nv)), rng.uniform(-1, 1, (WORLDS, model.nu)))


def _check(folder: Path, robot: _RandomRobot) -> None:
    table = robot.compile(folder)
    model = converged(table.models[0])
    states = _states(model, robot.rng)
    expected, (qpos, qvel) = evaluate(model, states), advance(model, states, 1)
    assert np.any(expected.cfrc_ext, axis=(1, 2)).mean() > 0.2
    read = list(table.touch_addresses)
    assert np.any(expected.sensordata[:, read])
    worlds = LaneWorlds(table, np.zeros(WORLDS, dtype=np.int64))
    qacc, cfrc_ext, touch = worlds.forward(*states)
    after_qpos, after_qvel, _, _ = worlds.step(*states, 1)
    errors = {
        "qacc": relative_error(qacc, expected.qacc),
        "cfrc_ext": relative_error(cfrc_ext, expected.cfrc_ext),
        "touch": relative_error(touch[:, read], expected.sensordata[:, read]),
        "qpos": relative_error(after_qpos, qpos),
        "qvel": relative_error(after_qvel, qvel),
    }
    assert max(errors.values()) < 1e-10, errors


def _lengths(rng: np.random.Generator, features: Collection[str]) -> list[int]:
    """Return the number of joints of each limb, with that of the trunk first."""
    if "trunk" in features:
        trunk, limbs = rng.integers(1, 4), rng.integers(2, 6)
        return [int(trunk), *rng.integers(1, 8, limbs).tolist()]
    if "unequal limbs" in features:
        return rng.integers(1, 4, rng.integers(2, 7)).tolist()  # type: ignore[no-any-return]
    limbs, joints = SHAPES[rng.integers(len(SHAPES))]
    return [joints] * limbs


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("shape", SHAPES, ids="{0[0]}x{0[1]}".format)
def test_random_robots_move_as_in_mujoco(tmp_path: Path, shape: tuple[int, int], integrator: str) -> None:
    rng = np.random.default_rng([*shape, *integrator.encode()])
    for _ in range(ROBOTS):
        _check(tmp_path, _RandomRobot(rng, [shape[1]] * shape[0], integrator))


@pytest.mark.parametrize("integrator", INTEGRATORS)
@pytest.mark.parametrize("feature", FEATURES)
def test_robots_with_a_feature_move_as_in_mujoco(tmp_path: Path, feature: str, integrator: str) -> None:
    rng = np.random.default_rng([*feature.encode(), *integrator.encode()])
    for _ in range(ROBOTS):
        _check(tmp_path, _RandomRobot(rng, _lengths(rng, [feature]), integrator, [feature]))


@pytest.mark.parametrize("integrator", INTEGRATORS)
def test_robots_with_any_features_move_as_in_mujoco(tmp_path: Path, integrator: str) -> None:
    rng = np.random.default_rng([*integrator.encode()])
    for _ in range(COMBINATIONS):
        features = [feature for feature in FEATURES if rng.random() < 0.5]
        _check(tmp_path, _RandomRobot(rng, _lengths(rng, features), integrator, features))
