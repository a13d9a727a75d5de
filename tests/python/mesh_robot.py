"""A copy of the toy robot in several files: an include in a folder, a mesh and a texture."""

from __future__ import annotations

import shutil
import struct
import zlib
from pathlib import Path

_ROBOTS = Path(__file__).parent / "robots"
_CORNERS = ((0.1, 0, 0), (0, 0.1, 0), (0, 0, 0.1), (0, 0, 0))
_FACES = ((1, 2, 3), (1, 4, 2), (2, 4, 3), (1, 3, 4))


def tetrahedron(height: float = 0.1) -> str:
    """Return a mesh in Wavefront's format."""
    corners = [(x, y, z * height / 0.1) for x, y, z in _CORNERS]
    return "".join(
        [*(f"v {x} {y} {z}\n" for x, y, z in corners), *(f"f {a} {b} {c}\n" for a, b, c in _FACES)]
    )


def png(colour: tuple[int, int, int] = (200, 40, 30)) -> bytes:
    """Return a picture of 4 by 4 pixels."""

    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    rows = b"".join(b"\0" + bytes(colour) * 4 for _ in range(4))
    size = struct.pack(">IIBBBBB", 4, 4, 8, 2, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n"
        + chunk(b"IHDR", size)
        + chunk(b"IDAT", zlib.compress(rows))
        + chunk(b"IEND", b"")
    )


def write_mesh_robot(folder: Path) -> Path:
    """Write a robot whose plate wears a mesh with a texture; return the path of its TOML."""
    for name in ("parts", "looks/shapes", "looks/pictures"):
        (folder / name).mkdir(parents=True)
    shutil.copy(_ROBOTS / "tripod.toml", folder / "tripod.toml")
    (folder / "looks" / "shapes" / "hat.obj").write_text(tetrahedron())
    (folder / "looks" / "pictures" / "red.png").write_bytes(png())
    (folder / "parts" / "looks.xml").write_text(
        "<mujoco>\n"
        '  <compiler meshdir="looks/shapes" texturedir="looks/pictures"/>\n'
        "  <asset>\n"
        '    <mesh file="hat.obj"/>\n'
        '    <texture type="2d" file="red.png"/>\n'
        '    <material name="red" texture="red"/>\n'
        "  </asset>\n"
        "</mujoco>\n"
    )
    text = (_ROBOTS / "tripod.xml").read_text()
    plate = '<geom type="cylinder" size="0.12 0.02" mass="1"/>'
    assert text.count(plate) == text.count("<worldbody>") == 1
    hat = (
        '<geom type="mesh" mesh="hat" material="red" pos="0 0 0.02" mass="0.05" contype="0" conaffinity="0"/>'
    )
    text = text.replace(plate, f"{plate}\n      {hat}")
    text = text.replace("<worldbody>", '<include file="parts/looks.xml"/>\n  <worldbody>')
    (folder / "tripod.xml").write_text(text)
    return folder / "tripod.toml"
