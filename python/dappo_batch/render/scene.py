"""The message to the drawing process: models, positions and camera."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from numpy.typing import NDArray

from dappo_batch.model import ClassTable
from dappo_batch.render.camera import AUTO, View, view
from dappo_batch.render.scenery import FLOOR, has_pattern, with_scenery
from dappo_batch.render.walk import Walk

__all__ = ["RED", "Scene", "bring_lights", "coloured_models", "copy_class", "fit", "painted", "scene"]

RED = (0.85, 0.16, 0.12, 1.0)
_LIMB = (0.36, 0.45, 0.55, 1.0)
_TRUNK = (0.85, 0.62, 0.25, 1.0)
_UNPAINTED = np.array([0.5, 0.5, 0.5, 1.0], np.float32)  # MuJoCo's colour of a geom that has none
_AMBIENT = 0.3  # of white light, so that shaded parts are visible
_SHADOW_PIXELS = 1024  # more take long without a graphics card
_SHADOW_REACHES = 1.25  # half of the width of the area with shadows, in reaches of the robot
_NEAR, _FAR = 0.02, 60.0  # range of depths, in distances of the camera
# Facets of round geoms: fewer than MuJoCo's, which take a third of the time without a graphics card.
_SLICES, _STACKS = 16, 8
_POSE = ("body_", "jnt_", "qpos", "geom_", "site_", "cam_", "tendon_")
_LOOK = ("mat_", "light_")


@dataclass(frozen=True, eq=False)
class Scene:
    """The frames to draw.

    Attributes
    ----------
    models : dict
        Coloured models by damage class.
    damage_classes : list of int
        Class of every frame.
    qpos : numpy.ndarray
        Positions of every frame, [F, nq].
    view : View
        The camera, with one place for every frame.
    start : numpy.ndarray
        Where the camera looks in the first frame of the film, [3].
    width, height : int
        Size of a frame.
    """

    models: dict[int, mujoco.MjModel]
    damage_classes: list[int]
    qpos: NDArray[np.float64]
    view: View
    start: NDArray[np.float64]
    width: int
    height: int

    def every(self, step: int, first: int) -> Scene:
        """Return the scene of every `step`-th frame from the frame `first` on."""
        chosen = slice(first, None, step)
        camera = replace(self.view, lookat=self.view.lookat[chosen])
        return replace(self, damage_classes=self.damage_classes[chosen], qpos=self.qpos[chosen], view=camera)


def scene(walk: Walk, states: Sequence[int], width: int, height: int, camera: str = AUTO) -> Scene:
    """Return the scene of some states of an episode."""
    every = walk.damage_classes
    seen = view(
        walk.table,
        walk.states,
        walk.step_seconds,
        camera=camera,
        damage_class=int(every[-1]),
        aspect=width / height,
    )
    classes = every[list(states)].tolist()
    models = coloured_models(walk.table, classes)
    for model in models.values():
        fit(model, seen)
    chosen = replace(seen, lookat=seen.lookat[list(states)])
    return Scene(models, classes, walk.states[list(states)], chosen, chosen.lookat[0], width, height)


def fit(model: mujoco.MjModel, seen: View) -> None:
    """Fit lights, shadows and depths of a model to a camera."""
    settings, scale = model.vis, model.stat.extent
    # The shadow map covers the robot.
    settings.map.shadowclip = _SHADOW_REACHES * seen.reach / scale
    _turn_lights(model, seen.azimuth)
    if seen.fixed < 0:
        settings.global_.fovy = seen.fovy
        settings.map.znear, settings.map.zfar = (share * seen.distance / scale for share in (_NEAR, _FAR))


def _turn_lights(model: mujoco.MjModel, azimuth: float) -> None:
    """Turn the directional lights of a model to the camera's side, along an axis of the world.

    The floor is speckled with shadow where rays fall obliquely to the axes: MuJoCo's shadow map is rounded.
    """
    across = round((azimuth - 45.0) / 90.0) * 90.0
    ahead = np.round([np.cos(np.radians(across)), np.sin(np.radians(across))])
    for light in np.flatnonzero(model.light_type == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL):
        if model.light_bodyid[light] == 0 and model.light_mode[light] == mujoco.mjtCamLight.mjCAMLIGHT_FIXED:
            direction = model.light_dir[light]
            direction[:2] = np.hypot(*direction[:2]) * ahead


def bring_lights(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    seen: View,
    lookat: NDArray[np.float64],
    start: NDArray[np.float64],
) -> None:
    """Move the lights of the world with a camera, from where it looked at the start to where it looks.

    Those at a distance must follow: MuJoCo draws their shadows only in front of where they stand.
    """
    for light in range(model.nlight):
        if model.light_type[light] == mujoco.mjtLightType.mjLIGHT_DIRECTIONAL:
            data.light_xpos[light] = lookat - seen.distance * data.light_xdir[light]
        elif (
            model.light_bodyid[light] == 0 and model.light_mode[light] == mujoco.mjtCamLight.mjCAMLIGHT_FIXED
        ):
            data.light_xpos[light, :2] += lookat[:2] - start[:2]


def coloured_models(table: ClassTable, classes: Sequence[int]) -> dict[int, mujoco.MjModel]:
    """Return a coloured model for each of the damage classes."""
    scenery = with_scenery(table)
    return {damage_class: painted(table, damage_class, scenery) for damage_class in set(classes)}


def copy_class(
    model: mujoco.MjModel, other: mujoco.MjModel, fields: Sequence[str] = (*_POSE, *_LOOK)
) -> None:
    """Copy fields that affect frames from the model of another class."""
    for name in dir(model):
        if name.startswith(tuple(fields)):
            numbers = getattr(model, name)
            if isinstance(numbers, np.ndarray):
                numbers[:] = getattr(other, name)


def painted(table: ClassTable, damage_class: int, scenery: mujoco.MjModel) -> mujoco.MjModel:
    """Return the model of a damage class for drawing.

    Parameters
    ----------
    table : ClassTable
        The robot.
    damage_class : int
        The class; its damaged limbs are red.
    scenery : mujoco.MjModel
        What `with_scenery` returned; it is left as it is.
    """
    model = copy.copy(scenery)
    copy_class(model, table.models[damage_class], _POSE)
    _colour(model, table)
    for limb, _ in table.space.classes[damage_class].damages:
        geoms = np.isin(model.geom_bodyid, table.limb_bodies[limb])
        model.geom_matid[geoms] = -1  # a material's colour has precedence over the geom's
        model.geom_rgba[geoms] = RED
    for plane in np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE):
        _tile(model, int(plane))
        _extend(model, int(plane))
    quality = model.vis.quality
    quality.shadowsize, quality.numslices, quality.numstacks = _SHADOW_PIXELS, _SLICES, _STACKS
    model.vis.headlight.ambient[:] = _AMBIENT
    return model


def _colour(model: mujoco.MjModel, table: ClassTable) -> None:
    """Give the parts of the robot that have no colour those of the package's own robots, and hide its sites.

    Sites without a colour are for sensors, and those of touch sensors would hide the limbs.
    """
    model.site_rgba[(model.site_matid < 0) & (model.site_rgba == _UNPAINTED).all(axis=1), 3] = 0.0
    bare = (model.geom_matid < 0) & (model.geom_rgba == _UNPAINTED).all(axis=1)
    bare &= model.body_rootid[model.geom_bodyid] == model.body_rootid[table.main_body]
    of_limb = np.isin(model.geom_bodyid, [body for bodies in table.limb_bodies for body in bodies])
    model.geom_rgba[bare & of_limb] = _LIMB
    model.geom_rgba[bare & ~of_limb] = _TRUNK


def _tile(model: mujoco.MjModel, plane: int) -> None:
    """Give a plane without a texture the chequered material, in its own colour if it has one."""
    floor = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_MATERIAL, FLOOR)
    if floor < 0 or has_pattern(model, plane):
        return
    material = int(model.geom_matid[plane])
    if material >= 0:
        model.geom_rgba[plane] = model.mat_rgba[material]
    elif (model.geom_rgba[plane] == _UNPAINTED).all():
        model.geom_rgba[plane] = 1.0
    model.geom_matid[plane] = floor


def _extend(model: mujoco.MjModel, plane: int) -> None:
    """Make a plane infinite, with tiles of the same size."""
    size, material = model.geom_size[plane], int(model.geom_matid[plane])
    if material >= 0 and not model.mat_texuniform[material]:
        # Texture repeats of an infinite plane are per metre, those of a finite one over its length.
        finite = size[:2] > 0
        model.mat_texrepeat[material][finite] /= 2 * size[:2][finite]
    size[:2] = 0.0
