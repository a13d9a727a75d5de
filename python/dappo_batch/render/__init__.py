"""Films of walking robots: damaged limbs turn red when the damage strikes.

`Walk` holds what to show, `write` draws it into an mp4, GIF or PNG file, `frames` returns the frames,
`view` opens a window, and `browse` serves a page.
"""

from __future__ import annotations

from dappo_batch.render.browser import browse, check_browser
from dappo_batch.render.camera import check_camera
from dappo_batch.render.errors import RenderError
from dappo_batch.render.film import check, frames, write
from dappo_batch.render.walk import Walk
from dappo_batch.render.window import check_screen, view

__all__ = [
    "RenderError",
    "Walk",
    "browse",
    "check",
    "check_browser",
    "check_camera",
    "check_screen",
    "frames",
    "view",
    "write",
]
