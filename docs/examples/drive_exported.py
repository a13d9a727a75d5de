"""Control a robot with an export folder while joints of it jam, with NumPy and onnxruntime.

MuJoCo simulates the healthy twin and the robot. Nothing else is needed. A policy that was exported without
a diagnoser does not adapt.

Usage: ``python docs/examples/drive_exported.py FOLDER [JOINT ...]``, by default two hips of an Ant
"""

from __future__ import annotations

import json
import sys
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import onnxruntime
from numpy.typing import ArrayLike, NDArray

ONSET, STEPS = 200, 600
JOINTS = ("hip_1", "hip_2")  # the damage class jammed_joint@0+jammed_joint@1
JAMMED = np.radians([-0.1, 0.1])


def network(path: Path) -> Callable[..., list[NDArray[np.float32]]]:
    """Load a network as a function of one row of each of its inputs."""
    session = onnxruntime.InferenceSession(path, providers=["CPUExecutionProvider"])
    names = [put.name for put in session.get_inputs()]

    def run(*rows: ArrayLike) -> list[NDArray[np.float32]]:
        inputs = {name: np.asarray(row, np.float32)[None] for name, row in zip(names, rows, strict=True)}
        return [out[0] for out in session.run(None, inputs)]

    return run


class Body:
    """A simulated robot."""

    def __init__(self, folder: Path, spec: dict[str, Any]) -> None:
        self.spec, self.model = spec, mujoco.MjModel.from_xml_path(str(folder / spec["mjcf"]))
        self.model.opt.integrator = getattr(mujoco.mjtIntegrator, f"mjINT_{spec['integrator'].upper()}")
        self.data = mujoco.MjData(self.model)

    def step(self, action: NDArray[np.float32]) -> NDArray[np.float32]:
        """Take a control step; return the observation."""
        self.data.ctrl = self.spec["action_scale"] * np.clip(action, -1, 1)
        mujoco.mj_step(self.model, self.data, self.spec["frame_skip"])
        mujoco.mj_rnePostConstraint(self.model, self.data)  # contact forces
        return self.observe()

    def observe(self) -> NDArray[np.float32]:
        """Return the observation, block by block."""
        blocks: list[ArrayLike] = []
        for term in self.spec["observation"]:
            if term["term"] == "cfrc_ext":
                blocks.append(np.clip(self.data.cfrc_ext.ravel(), -term["clip"], term["clip"]))
            elif term["term"] == "touch":
                blocks.append([self.data.sensor(name).data[0] > 0 for name in self.spec["touch_sensors"]])
            else:
                blocks.append(getattr(self.data, term["term"])[term.get("skip", 0) :])
        return np.concatenate(blocks).astype(np.float32)

    def synchronise(self, obs: NDArray[np.float32]) -> None:
        """Set the observed state; x and y do not matter on a level floor."""
        mujoco.mj_resetData(self.model, self.data)
        seen = self.model.nq - 2
        self.data.qpos, self.data.qvel = [0, 0, *obs[:seen]], obs[seen : seen + self.model.nv]
        mujoco.mj_forward(self.model, self.data)


class PolicyAlone:
    """The policy with the code of the healthy robot."""

    def __init__(self, folder: Path) -> None:
        export = json.loads((folder / "export.json").read_text())
        self.healthy_code = np.zeros(export["policy"]["code_length"])
        self.policy = network(folder / export["policy"]["onnx"])
        units = export["policy"].get("lstm")  # of a recurrent policy, whose hidden and cell state begin at 0
        self.state: list[ArrayLike] = [] if units is None else [np.zeros(units), np.zeros(units)]

    def act(self, obs: NDArray[np.float32]) -> NDArray[np.float32]:
        """Choose the next action."""
        action, _, *self.state = self.policy(np.concatenate([obs, self.healthy_code]), *self.state)
        return action


class Controller:
    """A controller: suspicion, diagnosis window, diagnosis, adaptation."""

    def __init__(self, folder: Path) -> None:
        self.export = json.loads((folder / "export.json").read_text())
        self.settings, self.classes = self.export["controller"], self.export["classes"]
        self.twin_spec = self.export["twin"]  # how the twin is simulated
        self.twin = Body(folder, self.twin_spec)
        expert = self.export["expert"] or self.export["policy"]
        self.healthy_code = np.zeros(expert["code_length"])
        self.policy = network(folder / self.export["policy"]["onnx"])
        self.expert = network(folder / expert["onnx"])
        self.diagnoser = network(folder / self.export["diagnoser"]["onnx"])
        self.assumed, self.step, self.cooldown = 0, 0, self.settings["cooldown"]
        self.residuals: deque[float] = deque(maxlen=self.settings["residual_window"])
        self.window: list[NDArray[np.float32]] | None = None  # the diagnosis window
        self.predicted: NDArray[np.float32] | None = None  # by the twin
        self.events: list[tuple[int, str]] = []

    def act(self, obs: NDArray[np.float32]) -> NDArray[np.float32]:
        """Choose the next action."""
        if self.window is not None and self.predicted is not None:
            parts = {"damaged": obs, "twin - damaged": self.predicted - obs, "action": self.mean_action}
            self.window.append(np.concatenate([parts[name] for name in self.export["diagnoser"]["inputs"]]))
            if len(self.window) == self.export["diagnoser"]["timesteps"]:
                self.diagnose()
        elif self.is_suspicious(obs):
            self.window = []
        walker = self.policy if self.window is None else self.expert
        code = self.classes[self.assumed]["code"] if self.window is None else self.healthy_code
        action, self.mean_action = walker(np.concatenate([obs, code]))
        self.predicted = self.step_twin(obs, self.mean_action)
        self.step += 1
        return action

    def is_suspicious(self, obs: NDArray[np.float32]) -> bool:
        """Compare the robot with its twin over the last steps."""
        if self.predicted is not None:
            scale = np.array(self.twin_spec["residual_scale"], np.float32)
            bound = self.export["policy"]["clip"]
            differences = np.clip((self.predicted - obs) * scale, -bound, bound)[scale > 0]
            self.residuals.append(float(np.sqrt(np.mean(differences**2))))
        self.cooldown -= 1
        if self.cooldown >= 0 or len(self.residuals) < self.settings["residual_window"]:
            return False
        median = sorted(self.residuals)[len(self.residuals) // 2]
        if median > self.settings["residual_threshold"]:
            self.record(f"residual {median:.2f}: suspicion, the diagnosis window begins")
            return True
        return False

    def diagnose(self) -> None:
        """Classify the damage from a full window."""
        (probabilities,) = self.diagnoser(np.array(self.window))
        likeliest = int(np.argmax(probabilities))
        self.record(f"diagnosis: {self.classes[likeliest]['name']}, {probabilities[likeliest]:.1%} certain")
        if probabilities[likeliest] >= self.settings["confidence"]:
            self.assumed = likeliest
        self.window, self.cooldown = None, self.settings["cooldown"]
        self.residuals.clear()

    def step_twin(self, obs: NDArray[np.float32], action: NDArray[np.float32]) -> NDArray[np.float32] | None:
        """Step the healthy twin with the robot, until a damage is assumed."""
        if self.assumed != 0 and self.window is None:
            return None
        row, resync = len(self.window or ()), self.twin_spec["resync"]
        if row == 0 or (resync > 0 and row % resync == 0):
            self.twin.synchronise(obs)
            self.predicted = obs
        if self.window is not None and self.twin_spec["action"] == "own":
            _, action = self.expert(np.concatenate([self.predicted, self.healthy_code]))
        return self.twin.step(action)

    def record(self, event: str) -> None:
        """Record and print an event."""
        self.events.append((self.step, event))
        print(f"step {self.step:4}: {event}")


def main() -> None:
    """Simulate damage in mid-episode under the exported controller."""
    folder, joints = Path(sys.argv[1]), sys.argv[2:] or JOINTS
    export = json.loads((folder / "export.json").read_text())
    if export["diagnoser"] and export["twin"]["action"] is None:
        raise SystemExit("the diagnoser of this export has no twin, which this example is about")
    walker = Controller(folder) if export["diagnoser"] else PolicyAlone(folder)
    robot = Body(folder, export["twin"])
    places, obs = [robot.data.qpos[0]], robot.observe()
    for step in range(STEPS):
        if step == ONSET:
            for name in joints:
                robot.model.joint(name).range = JAMMED
            print(f"step {step:4}: {' and '.join(joints)} jam")
        obs = robot.step(walker.act(obs))
        places.append(robot.data.qpos[0])
    if isinstance(walker, Controller):
        print(f"assumed class: {walker.classes[walker.assumed]['name']}")
    for first, last in ((0, ONSET), (ONSET, ONSET + 100), (ONSET + 100, STEPS)):
        seconds = (last - first) * export["control_period"]
        print(f"steps {first:4} to {last:4}: {(places[last] - places[first]) / seconds:.2f} m/s")


if __name__ == "__main__":
    main()
