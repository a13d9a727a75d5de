"""Scenery of films: a sky, a chequered floor and a light, if the MJCF has none.

All of it is added to copies that are drawn, never to the models that are simulated.
"""

from __future__ import annotations

import copy
import math

import mujoco
import numpy as np

from dappo_batch.model import ClassTable
from dappo_batch.model.mujoco_library import MUJOCO_ERRORS, quiet_mujoco
from dappo_batch.render.extent import extent
from dappo_batch.robots.mjcf import read_mjcf

__all__ = ["FLOOR", "has_pattern", "with_scenery"]

FLOOR = "dappo_batch_floor"
"""Name of the material of a floor that has none."""

_SKY = "dappo_batch_sky"
_SKYBOX = mujoco.mjtTexture.mjTEXTURE_SKYBOX
_RGB = int(mujoco.mjtTextureRole.mjTEXROLE_RGB)
_TILE = 0.8  # of the robot's reach, rounded to 1, 2 or 5 times a power of ten
_UNREADABLE: tuple[type[Exception], ...] = (*MUJOCO_ERRORS, OSError)
_LIGHT_DIRECTION = (0.3, 0.4, -1.0)


def with_scenery(table: ClassTable) -> mujoco.MjModel:
    """Return a copy of the healthy model of a robot with a sky, a material for floors and a light."""
    healthy = table.models[0]
    planes = np.flatnonzero(healthy.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)
    lacks_sky = not (healthy.tex_type == _SKYBOX).any()
    lacks_floor = not all(has_pattern(healthy, int(plane)) for plane in planes)
    if not (lacks_sky or lacks_floor or healthy.nlight == 0):
        return copy.copy(healthy)
    try:
        spec = read_mjcf(table.robot.mjcf_path)
        spec.compiler.usethread = False
        if lacks_sky:
            _add_sky(spec)
        if lacks_floor:
            _add_floor(spec, _tile(table))
        if healthy.nlight == 0:
            _add_light(spec)
        with quiet_mujoco():
            model: mujoco.MjModel = spec.compile()
    except _UNREADABLE:
        return copy.copy(healthy)
    # The file may have changed since the robot was compiled: then it is shown as it was.
    same = all(getattr(model, size) == getattr(healthy, size) for size in ("nq", "nbody", "ngeom", "nmesh"))
    return model if same else copy.copy(healthy)


def has_pattern(model: mujoco.MjModel, geom: int) -> bool:
    """Return whether a geom has a texture."""
    material = int(model.geom_matid[geom])
    return material >= 0 and bool((model.mat_texid[material] >= 0).any())


def _tile(table: ClassTable) -> float:
    """Return the side of a tile, m."""
    wanted = _TILE * extent(table, table.models[0].qpos0[None]).reach
    power = 10.0 ** math.floor(math.log10(wanted))
    return min((power * step for step in (1, 2, 5, 10)), key=lambda side: abs(math.log(side / wanted)))


def _add_sky(spec: mujoco.MjSpec) -> None:
    spec.add_texture(
        name=_SKY,
        type=_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=(0.93, 0.95, 0.97),
        rgb2=(0.62, 0.70, 0.78),
        width=16,
        height=96,
    )


def _add_floor(spec: mujoco.MjSpec, tile: float) -> None:
    spec.add_texture(
        name=FLOOR,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=(0.78, 0.80, 0.82),
        rgb2=(0.70, 0.73, 0.76),
        width=64,
        height=64,
    )
    material = spec.add_material(name=FLOOR, texrepeat=(0.5 / tile, 0.5 / tile), texuniform=True)
    material.textures[_RGB] = FLOOR


def _add_light(spec: mujoco.MjSpec) -> None:
    spec.worldbody.add_light(
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        dir=_LIGHT_DIRECTION,
        diffuse=(0.8, 0.8, 0.8),
        specular=(0.1, 0.1, 0.1),
        castshadow=True,
    )
