"""Writing captions onto pictures."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from dappo_batch.render.captions import Caption
from dappo_batch.render.errors import RenderError

__all__ = ["letter"]

_INK = (30, 36, 44)
_RED = (186, 24, 16)
_PAPER = (255, 255, 255, 205)  # lets the picture shine through a little
_LINES = 22  # of text that a picture is high, if the longest line leaves it at that
_SMALLEST = 9  # pixels


def letter(
    pictures: Iterable[NDArray[np.uint8]], captions: Sequence[Caption], width: int, height: int
) -> Iterator[NDArray[np.uint8]]:
    """Write one caption onto each picture, uint8[height, width, 3], in its upper left corner."""
    font = _font(captions, width, height)
    # As wide as the longest caption throughout, so that it does not jump.
    widest = max(font.getlength(line) for caption in captions for line, _ in _lines(caption))
    pad, step = font.size * 0.5, font.size * 1.35
    for pixels, caption in zip(pictures, captions, strict=True):
        lines = _lines(caption)
        picture = Image.fromarray(pixels)
        pen = ImageDraw.Draw(picture, "RGBA")
        box = (pad, pad, 3 * pad + widest, 2.4 * pad + step * len(lines))
        pen.rounded_rectangle(box, radius=pad, fill=_PAPER)
        for row, (line, colour) in enumerate(lines):
            pen.text((2 * pad, 1.7 * pad + row * step), line, font=font, fill=colour)
        yield np.asarray(picture)


def _lines(caption: Caption) -> list[tuple[str, tuple[int, int, int]]]:
    damage = (caption.damage, _RED if caption.damaged else _INK)
    return [line for line in ((caption.time, _INK), damage, (caption.belief, _INK)) if line[0]]


def _font(captions: Sequence[Caption], width: int, height: int) -> ImageFont.FreeTypeFont:
    """Return the font in the largest size in which all lines fit."""
    texts = {line for caption in captions for line, _ in _lines(caption)}
    for size in range(max(_SMALLEST, height // _LINES), _SMALLEST, -1):
        font = _of_size(size)
        if max(map(font.getlength, texts)) <= width - 2 * size:
            return font
    return _of_size(_SMALLEST)


def _of_size(size: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    if not isinstance(font, ImageFont.FreeTypeFont):
        raise RenderError("captions need a pillow with FreeType, which all of its wheels have")
    return font
