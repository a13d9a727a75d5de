"""A picture of a robot with a tile for each damage class."""

from __future__ import annotations

from dataclasses import replace
from os import PathLike
from pathlib import Path

import numpy as np

from dappo_batch._core import ConfigError
from dappo_batch.model import ClassTable
from dappo_batch.render import film
from dappo_batch.render.camera import view
from dappo_batch.render.captions import Caption
from dappo_batch.render.opengl import draw
from dappo_batch.render.scene import Scene, coloured_models, fit

__all__ = ["MOST", "check", "write"]

MOST = 36
"""Maximum number of tiles."""
_WIDTH, _HEIGHT = 320, 240


def check(path: str | bytes | PathLike[str]) -> Path:
    """Return the path for `write` after a check.

    Raises
    ------
    ConfigError
        If it does not end in ``.png``, or its folder does not exist.
    MissingExtraError
        If packages are missing.
    """
    file = film.check(path)
    if file.suffix.lower() != ".png":
        raise ConfigError(f"{file} ends in {file.suffix!r}, expected .png")
    return file


def write(path: Path, table: ClassTable) -> None:
    """Draw the first `MOST` damage classes in the pose in which episodes begin, damaged limbs in red.

    Parameters
    ----------
    path : pathlib.Path
        A PNG file.
    table : ClassTable
        The robot.

    Raises
    ------
    RenderError
        If rendering is not possible, or the file cannot be written.
    """
    from dappo_batch.render.encoders import write_png
    from dappo_batch.render.lettering import letter

    classes = table.space.classes[:MOST]
    numbers = [item.id for item in classes]
    poses = np.array([table.models[number].qpos0 for number in numbers])
    seen = view(table, poses[:1], 1.0, aspect=_WIDTH / _HEIGHT)
    models = coloured_models(table, numbers)
    for model in models.values():
        fit(model, seen)
    seen = replace(seen, lookat=np.repeat(seen.lookat, len(classes), axis=0))
    scene = Scene(models, numbers, poses, seen, seen.lookat[0], _WIDTH, _HEIGHT)
    # A name may be longer than a tile is wide, and lines are broken at spaces.
    captions = [Caption("", item.name.replace("+", " + "), "", bool(item.damages)) for item in classes]
    with film.whole(path) as part:
        write_png(part, letter(draw(scene), captions, _WIDTH, _HEIGHT))
