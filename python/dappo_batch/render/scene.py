"""Everything that a painter needs to know, and nothing more."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import NDArray

from dappo_batch.model import ClassTable
from dappo_batch.render.camera import View, view
from dappo_batch.render.walk import Walk

__all__ = ["RED", "Scene", "become", "looks", "painted", "scene"]

RED = (0.85, 0.16, 0.12, 1.0)
_AMBIENT = 0.3  # of white light: what lies in the shade can still be told apart
_SHADOW_PIXELS = 2048  # fewer cast dots of shadow on limbs; more take long without a graphics card


@dataclass(frozen=True, eq=False)
class Scene:
    """The pictures that are to be drawn.

    Attributes
    ----------
    models : dict
        From damage class to a model with its colours.
    damage_classes : list of int
        Class of every picture.
    qpos : numpy.ndarray
        Positions of every picture, [F, nq].
    view : View
        The camera, with one place for every picture.
    width, height : int
        Size of a picture.
    """

    models: dict[int, mujoco.MjModel]
    damage_classes: list[int]
    qpos: NDArray[np.float64]
    view: View
    width: int
    height: int


def scene(walk: Walk, states: Sequence[int], width: int, height: int) -> Scene:
    """Return the pictures of some states of a walk."""
    seen = view(walk.table, walk.states, walk.step_seconds)
    classes = walk.damage_classes[list(states)].tolist()
    models = looks(walk.table, classes)
    for model in models.values():
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        model.vis.global_.fovy = seen.fovy
        # Shadows are needed, and sharp, where the camera looks.
        model.vis.map.shadowclip = seen.distance / model.stat.extent
    chosen = View(seen.azimuth, seen.elevation, seen.distance, seen.fovy, seen.lookat[list(states)])
    return Scene(models, classes, walk.states[list(states)], chosen, width, height)


def looks(table: ClassTable, classes: Sequence[int]) -> dict[int, mujoco.MjModel]:
    """Return a model with its colours for every damage class that occurs."""
    return {damage_class: painted(table, damage_class) for damage_class in set(classes)}


def become(model: mujoco.MjModel, other: mujoco.MjModel) -> None:
    """Let a model look and move as another of its class table."""
    for name in dir(model):
        if name.startswith(("body_", "jnt_", "geom_", "mat_", "site_", "cam_", "light_")):
            numbers = getattr(model, name)
            if isinstance(numbers, np.ndarray):
                numbers[:] = getattr(other, name)


def painted(table: ClassTable, damage_class: int) -> mujoco.MjModel:
    """Return a copy of a class's model: damaged limbs are red, and the floor has no end."""
    model = copy.copy(table.models[damage_class])
    for limb, _ in table.space.classes[damage_class].damages:
        geoms = np.isin(model.geom_bodyid, table.limb_bodies[limb])
        model.geom_matid[geoms] = -1  # a material's colour would win over the geom's
        model.geom_rgba[geoms] = RED
    for plane in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE):
        _extend(model, int(plane))
    model.vis.quality.shadowsize = _SHADOW_PIXELS
    model.vis.headlight.ambient[:] = _AMBIENT
    return model


def _extend(model: mujoco.MjModel, plane: int) -> None:
    """Let a plane reach to the horizon wherever the robot walks, its tiles as large as before."""
    size, material = model.geom_size[plane], int(model.geom_matid[plane])
    if material >= 0 and not model.mat_texuniform[material]:
        # The repeats of an endless plane count per metre, those of another one along its whole length.
        finite = size[:2] > 0
        model.mat_texrepeat[material][finite] /= 2 * size[:2][finite]
    size[:2] = 0.0
