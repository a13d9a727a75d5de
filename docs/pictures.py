"""Draw the pictures of the documentation: every robot, healthy and damaged, damaged limbs in red.

Usage: ``python docs/pictures.py``
"""

from __future__ import annotations

from pathlib import Path

import mujoco

from dappo_batch import compile_class_table
from dappo_batch.render import Walk, write

FOLDER = Path(__file__).resolve().parent / "images"
SIZE = (480, 360)
PICTURES = {
    "ant": {"healthy": "healthy", "damaged": "missing_toe@2+jammed_joint@3"},
    "hexapod": {"healthy": "healthy", "damaged": "missing_toe@1+jammed_joint@0"},
    "go1": {"healthy": "healthy", "damaged": "jammed_joint@0+weak_motor@3"},
    "go2": {"healthy": "healthy", "damaged": "jammed_joint@0+weak_motor@3"},
}


def main() -> None:
    """Write all pictures."""
    FOLDER.mkdir(exist_ok=True)
    for robot, classes in PICTURES.items():
        table = compile_class_table(robot)
        for label, damage in classes.items():
            model = table.models[table.space.parse(damage)]
            data = table.worker_data(1)[0]
            if model.nkey:  # servo targets of the standing pose
                mujoco.mj_resetDataKeyframe(model, data, 0)
            # Two seconds with constant controls, so that the robot rests on what is left of its limbs.
            mujoco.mj_step(model, data, nstep=round(2.0 / model.opt.timestep))
            path = FOLDER / f"{robot}_{label}.png"
            write(path, Walk(table, data.qpos, damage), size=SIZE, captioned=False)
            print(f"{path} ({path.stat().st_size / 1024:.0f} KB)")


if __name__ == "__main__":
    main()
