"""Contacts that the masks of geoms allow, in an MJCF that is not compiled yet."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    import mujoco

__all__ = ["is_static", "masks_match", "touches_itself"]


def is_static(body: mujoco.MjsBody) -> bool:
    """Return whether a body cannot move: neither it nor any body above it has a joint."""
    while body.name != "world":
        if body.joints:
            return False
        body = body.parent
    return True


def masks_match(a: mujoco.MjsGeom, b: mujoco.MjsGeom) -> bool:
    """Return whether the masks of two geoms allow their contact."""
    return bool(a.contype & b.conaffinity or b.contype & a.conaffinity)


def touches_itself(geoms: Sequence[mujoco.MjsGeom]) -> bool:
    """Return whether the masks of some geoms allow contacts between them."""
    # There are few different masks, however many geoms there are.
    masks = {(geom.contype, geom.conaffinity) for geom in geoms}
    return any(a[0] & b[1] for a in masks for b in masks)
