"""Drawing of captions onto pictures."""

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
_PAPER = (255, 255, 255, 205)  # slightly transparent
_LINES = 24  # of text that a picture is high
_SMALLEST = 9  # pixels


def letter(
    pictures: Iterable[NDArray[np.uint8]], captions: Sequence[Caption], width: int, height: int
) -> Iterator[NDArray[np.uint8]]:
    """Write one caption onto each picture, uint8[height, width, 3], in its upper left corner."""
    font = _of_size(max(_SMALLEST, height // _LINES))
    pad, step = font.size * 0.5, font.size * 1.35
    wrapped = [_wrapped(caption, font, width - 4 * pad) for caption in captions]
    # All captions are as wide as the longest line.
    widest = max(font.getlength(line) for lines in wrapped for line, _ in lines)
    for pixels, lines in zip(pictures, wrapped, strict=True):
        box = (pad, pad, 3 * pad + widest, 2.4 * pad + step * len(lines))
        picture = Image.fromarray(pixels)
        pen = ImageDraw.Draw(picture, "RGBA")
        pen.rounded_rectangle(box, radius=pad, fill=_PAPER)
        for row, (line, colour) in enumerate(lines):
            pen.text((2 * pad, 1.7 * pad + row * step), line, font=font, fill=colour)
        yield np.asarray(picture)


def _wrapped(
    caption: Caption, font: ImageFont.FreeTypeFont, width: float
) -> list[tuple[str, tuple[int, int, int]]]:
    """Return the lines of a caption and their colours, broken between words where they are too long."""
    damage = _RED if caption.damaged else _INK
    lines = []
    for text, colour in ((caption.time, _INK), (caption.damage, damage), (caption.finding, _INK)):
        line = ""
        for word in text.split(" "):
            if line and font.getlength(f"{line} {word}") > width:
                lines.append((line, colour))
                line = word
            else:
                line = f"{line} {word}" if line else word
        if line:
            lines.append((line, colour))
    return lines


def _of_size(size: int) -> ImageFont.FreeTypeFont:
    font = ImageFont.load_default(size)
    if not isinstance(font, ImageFont.FreeTypeFont):
        raise RenderError("captions need a pillow with FreeType, which all of its wheels have")
    return font
