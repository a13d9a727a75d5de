"""What ``[simplify]`` costs: open-loop trots of a Go1 in libmujoco, as published and simplified.

Usage: ``python -m tests.parity.zoo.gaits [GAITS]``; docs/guides/known-robots.md has its table for 200 gaits.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from dappo_batch import compile_class_table

from .vendors import install_wheels, place

ROBOT = "go1_menagerie"
SECONDS = 5.0
CONTROL_STEP = 0.02
"""s; contacts are counted once a control step."""

FEET = 'self_collision = false\nfloor_contacts = ["FL", "RL", "RR", "FR"]\n'
SIMPLIFIED = {
    "as published": "",
    "as published, joints 0.001 rad off": "",
    "`self_collision = false`": "self_collision = false\n",
    "feet alone touch the floor": FEET,
    'feet, `timestep = 0.004`, `integrator = "implicitfast"`': (
        FEET + 'timestep = 0.004\nintegrator = "implicitfast"\n'
    ),
    "feet, `condim = 3`": FEET + "condim = 3\n",
    "feet, `impratio = 1`": FEET + "impratio = 1.0\n",
    'feet, `cone = "pyramidal"`': FEET + 'cone = "pyramidal"\n',
    'feet, `cone = "pyramidal"`, `impratio = 1`, `condim = 3`': (
        FEET + 'cone = "pyramidal"\nimpratio = 1.0\ncondim = 3\n'
    ),
}
"""The table ``[simplify]`` of each row."""

RANGES = {
    "frequency": (1.5, 3.5),
    "stride": (0.05, 0.35),
    "lift": (0.15, 0.6),
    "thigh": (0.75, 1.05),
    "calf": (-1.9, -1.5),
    "hip": (-0.1, 0.1),
    "turn": (-0.1, 0.1),
}
"""Parameters of a gait: Hz, and radians of the joints."""


class Walk(NamedTuple):
    """What a gait leads to."""

    distance: float
    """Along x until the end or a fall, m."""
    fell: bool
    contacts: float
    """Mean number at a time."""
    self_contacts: float
    """Those within the robot."""


def main() -> None:
    """Print one row for each way to simplify the robot."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    rng = np.random.default_rng(0)
    drawn = {name: rng.uniform(*bounds, count) for name, bounds in RANGES.items()}
    gaits = [{name: float(values[index]) for name, values in drawn.items()} for index in range(count)]
    toml = place(install_wheels(), ROBOT, simplified=False)
    published: list[Walk] = []
    print("| the Go1 | falls | distance, m | change of a gait's distance, m | contacts | within the robot |")
    print("|---|---|---|---|---|---|")
    for row, simplify in SIMPLIFIED.items():
        model = _model(toml, simplify)
        off = 1e-3 if "off" in row else 0.0
        walks = [_walk(model, gait, off * rng.uniform(-1, 1, model.nu)) for gait in gaits]
        published = published or walks
        print(f"| {row} | {_summary(walks, published)} |", flush=True)
    for deviation in (0.1, 0.3, 0.6):
        share = _self_contacts(_model(toml, ""), deviation)
        print(
            f"random targets, {deviation} rad: contacts within the robot in {share:.1%} of the control steps"
        )


def _model(toml: Path, simplify: str) -> mujoco.MjModel:
    path = toml.with_name("gaits.toml")
    path.write_text(f"{toml.read_text()}\n[simplify]\n{simplify}")
    return compile_class_table(path, max_damaged_limbs=0).models[0]


def _walk(model: mujoco.MjModel, gait: dict[str, float], off: NDArray[np.float64]) -> Walk:
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    data.qpos[7:] += off
    substeps = round(CONTROL_STEP / model.opt.timestep)
    contacts, within, fell, distance = [], [], False, 0.0
    for _ in range(round(SECONDS / CONTROL_STEP)):
        data.ctrl[:] = _targets(model, gait, data.time)
        mujoco.mj_step(model, data, nstep=substeps)
        contacts.append(data.ncon)
        within.append(_contacts_within(model, data))
        _, x, y, _ = data.qpos[3:7]
        fell = data.qpos[2] < 0.15 or 1.0 - 2.0 * (x * x + y * y) < 0.5
        if fell:
            break
        distance = float(data.qpos[0])
    return Walk(distance, fell, float(np.mean(contacts)), float(np.mean(within)))


def _self_contacts(model: mujoco.MjModel, deviation: float) -> float:
    """Return the share of control steps with contacts within a robot with random targets."""
    rng = np.random.default_rng(0)
    data = mujoco.MjData(model)
    substeps = round(CONTROL_STEP / model.opt.timestep)
    within = []
    for _ in range(20):
        mujoco.mj_resetDataKeyframe(model, data, 0)
        for _ in range(150):
            data.ctrl[:] = model.key_qpos[0, 7:] + deviation * rng.normal(size=model.nu)
            mujoco.mj_step(model, data, nstep=substeps)
            within.append(_contacts_within(model, data) > 0)
    return float(np.mean(within))


def _contacts_within(model: mujoco.MjModel, data: mujoco.MjData) -> int:
    """Return the number of contacts between geoms of the robot."""
    return int((data.contact.geom != model.geom("floor").id).all(axis=1).sum()) if data.ncon else 0


def _targets(model: mujoco.MjModel, gait: dict[str, float], time: float) -> list[float]:
    """Return the angles of a trot: diagonal legs are half a period apart, a leg swings in its first half."""
    targets = []
    growth = min(1.0, time / 0.5)
    for index in range(model.nu):
        leg, joint = model.actuator(index).name.split("_")
        side = 1.0 if leg[1] == "L" else -1.0
        phase = (time * gait["frequency"] + (0.0 if leg in ("FR", "RL") else 0.5)) % 1.0
        swings = phase < 0.5
        forward = -math.cos(2 * math.pi * phase) if swings else math.cos(2 * math.pi * (phase - 0.5))
        lift = growth * gait["lift"] * (math.sin(2 * math.pi * phase) if swings else 0.0)
        stride = growth * gait["stride"] * (1.0 + gait["turn"] * side)
        angles = {
            "hip": gait["hip"] * side,
            "thigh": gait["thigh"] - stride * forward + 0.5 * lift,
            "calf": gait["calf"] - lift,
        }
        targets.append(angles[joint])
    return targets


def _summary(walks: list[Walk], published: list[Walk]) -> str:
    """Return the numbers of a row; distances are those of gaits that fall in neither case."""
    upright = [(ours, theirs) for ours, theirs in zip(walks, published, strict=True) if not ours.fell]
    change = np.array([ours.distance - theirs.distance for ours, theirs in upright if not theirs.fell])
    spread = f"{np.median(abs(change)):.3f} (90 %: {np.percentile(abs(change), 90):.2f})"
    columns = [
        str(sum(walk.fell for walk in walks)),
        f"{np.median([ours.distance for ours, _ in upright]):.2f}",
        f"{spread}, mean {np.mean(change):+.2f}",
        f"{np.mean([walk.contacts for walk in walks]):.2f}",
        f"{np.mean([walk.self_contacts for walk in walks]):.3f}",
    ]
    return " | ".join(columns)


if __name__ == "__main__":
    main()
