"""Frames into files: mp4, GIF and PNG."""

from __future__ import annotations

import math
import tempfile
from collections.abc import Iterable, Iterator
from fractions import Fraction
from pathlib import Path
from typing import IO

import av
import numpy as np
from numpy.typing import NDArray
from PIL import Image

__all__ = ["write_gif", "write_mp4", "write_png"]

Pictures = Iterable[NDArray[np.uint8]]

_QUALITY = "20"  # of H.264: smaller is better; artefacts are hardly visible
_PRESET = "veryfast"  # of H.264: half of the default time, for files that are hardly larger
_GIF_COLOURS = 48  # more colours only store more noise
_ROW = 4  # most pictures in a row of a PNG
_GAP = 4  # pixels between two of them
_PALETTE_SAMPLES = 8  # pictures of a GIF from which its palette is computed


def write_mp4(path: Path, pictures: Pictures, seconds: float) -> None:
    """Write pictures, each uint8[height, width, 3] with even sizes, as H.264, each shown for `seconds`."""
    rate = Fraction(1.0 / seconds).limit_denominator(1000)
    with av.open(str(path), "w", format="mp4", options={"movflags": "faststart"}) as file:
        stream = None
        for picture in pictures:
            if stream is None:
                # H.264 with halved colour resolution, which every browser and player supports.
                stream = file.add_stream("libx264", rate=rate, options={"crf": _QUALITY, "preset": _PRESET})
                stream.height, stream.width = picture.shape[:2]
                stream.pix_fmt = "yuv420p"
            file.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        if stream is not None:
            file.mux(stream.encode())


def write_gif(path: Path, pictures: Pictures, seconds: float) -> None:
    """Write pictures, each uint8[height, width, 3], as a GIF in a loop, each shown for `seconds`."""
    with tempfile.TemporaryFile() as spool:
        # One palette for all pictures, so that colours do not flicker.
        shape, count = (0, 0, 3), 0
        for picture in pictures:
            shape, count = picture.shape, count + 1
            spool.write(picture.tobytes())
        step = max(1, math.ceil(count / _PALETTE_SAMPLES))
        samples = np.concatenate(list(_spooled(spool, shape, range(0, count, step))))
        palette = Image.fromarray(samples).quantize(_GIF_COLOURS, method=Image.Quantize.FASTOCTREE)
        # Dithering would double the size of the file.
        reduced = (
            Image.fromarray(picture).quantize(palette=palette, dither=Image.Dither.NONE)
            for picture in _spooled(spool, shape, range(count))
        )
        next(reduced).save(
            path,
            format="GIF",
            save_all=True,
            append_images=reduced,
            duration=round(1000 * seconds),
            loop=0,
            optimize=False,
        )


def write_png(path: Path, pictures: Pictures) -> None:
    """Write all pictures, each uint8[height, width, 3], into one, in rows of at most `_ROW`."""
    shown = list(pictures)
    height, width = shown[0].shape[:2]
    columns = math.ceil(len(shown) / math.ceil(len(shown) / _ROW))
    rows = math.ceil(len(shown) / columns)
    strip = Image.new("RGB", (columns * (width + _GAP) - _GAP, rows * (height + _GAP) - _GAP), "white")
    for index, picture in enumerate(shown):
        row, column = divmod(index, columns)
        strip.paste(Image.fromarray(picture), (column * (width + _GAP), row * (height + _GAP)))
    strip.save(path, format="PNG", optimize=True)


def _spooled(spool: IO[bytes], shape: tuple[int, ...], indices: Iterable[int]) -> Iterator[NDArray[np.uint8]]:
    size = math.prod(shape)
    for index in indices:
        spool.seek(index * size)
        yield np.frombuffer(spool.read(size), np.uint8).reshape(shape)
