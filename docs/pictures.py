"""Render the pictures of the documentation: every robot, healthy and damaged, damaged limbs in red.

Usage: ``MUJOCO_GL=egl python docs/pictures.py`` (or ``MUJOCO_GL=osmesa`` on a machine without EGL).
"""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import mujoco
import numpy as np

from dappo_batch import ClassTable, compile_class_table

FOLDER = Path(__file__).resolve().parent / "images"
WIDTH, HEIGHT = 480, 360
RED = (0.85, 0.16, 0.12, 1.0)
PICTURES = {
    "ant": {"healthy": "healthy", "damaged": "missing_toe@2+jammed_joint@3"},
    "hexapod": {"healthy": "healthy", "damaged": "missing_toe@1+jammed_joint@0"},
}


def main() -> None:
    """Write all pictures."""
    FOLDER.mkdir(exist_ok=True)
    for robot, classes in PICTURES.items():
        table = compile_class_table(robot)
        for label, damage in classes.items():
            path = FOLDER / f"{robot}_{label}.png"
            path.write_bytes(png(picture(table, table.space.parse(damage))))
            print(f"{path} ({path.stat().st_size / 1024:.0f} KB)")


def picture(table: ClassTable, class_id: int) -> np.ndarray:
    """Return a picture of one damage class, uint8[HEIGHT, WIDTH, 3]."""
    model = table.models[class_id]
    for limb, _ in table.space.classes[class_id].damages:
        geoms = np.isin(model.geom_bodyid, table.limb_bodies[limb])
        model.geom_matid[geoms] = -1  # a material's colour would win over the geom's
        model.geom_rgba[geoms] = RED
    data = table.worker_data(1)[0]
    # Two seconds without action, so that the robot rests on what is left of its limbs.
    mujoco.mj_step(model, data, nstep=round(2.0 / model.opt.timestep))
    with mujoco.Renderer(model, HEIGHT, WIDTH) as renderer:
        renderer.update_scene(data, camera=table.robot.spec["pictures"]["camera"])
        return renderer.render()


def png(pixels: np.ndarray) -> bytes:
    """Return uint8[height, width, 3] as a PNG file; a library for this alone would be one too many."""
    height, width, _ = pixels.shape
    # Each row begins with its filter: 2, the difference to the row above, which suits smooth pictures.
    above = np.vstack([np.zeros_like(pixels[:1]), pixels[:-1]])
    rows = np.full((height, 1 + 3 * width), 2, dtype=np.uint8)
    rows[:, 1:] = (pixels - above).reshape(height, -1)

    def chunk(kind: bytes, content: bytes) -> bytes:
        return (
            struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))
        )

    header = struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0)
    body = chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(rows.tobytes(), 9)) + chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + body


if __name__ == "__main__":
    main()
