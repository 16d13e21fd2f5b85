"""What a person has painted on the picture of a map: read from an image editor's file, as cells.

The picture is `map.pgm` of the results, saved again by any editor as PGM or PNG, in the same size. White over
anything erases, black over anything is a wall, a colour keeps robots out, and every other grey is left alone:
the soft edge of a brush paints nothing.
"""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from processing.dpslam.layer import Layer, Paint
from processing.se2 import Pose
from runtime.formats.errors import FormatError
from runtime.formats.map_server import FREE, OCCUPIED_THRESHOLD, READ_FREE_THRESHOLD
from runtime.formats.map_server import OCCUPIED as BLACK
from runtime.formats.session import Parts

COLOURED = 60
"""Channels of a colour differ by so much at least; greys that an editor has touched, by less."""

Grey = NDArray[np.uint8]
Cells = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class Painted:
    """Cells (N, 2), row and column from the map's origin, by what was painted on them."""

    cells: Mapping[Paint, Cells]
    left_alone: int
    """Pixels that differ and are neither black, white nor coloured."""

    def on(self, layer: Layer, path: Pose) -> Layer:
        """Return the layer with this painted over it."""
        for paint, cells in self.cells.items():
            layer = layer.painted(cells, paint, path)
        return layer


def read_edited(path: Path, parts: Parts) -> Painted:
    """Compare an edited picture to the one that was written with a session.

    Raises:
        FormatError: It is no picture, or of another size.
    """
    edited, written = _pixels(path, parts), np.asarray(Image.open(io.BytesIO(parts.picture)).convert("L"))
    spread = edited.max(axis=2).astype(np.int64) - edited.min(axis=2)
    coloured = spread > COLOURED
    grey = edited.mean(axis=2)
    dark = (255.0 - grey) / 255.0
    black, white = ~coloured & (dark > OCCUPIED_THRESHOLD), ~coloured & (dark < READ_FREE_THRESHOLD)
    walls, erased = black & (written != BLACK), white & (written != FREE)
    other = ~coloured & ~black & ~white & (np.abs(grey - written) > 1.0)
    masks = {Paint.ERASED: erased, Paint.WALL: walls, Paint.KEEP_OUT: coloured}
    return Painted({paint: _cells(mask, parts) for paint, mask in masks.items()}, int(other.sum()))


def read_mask(path: Path, parts: Parts) -> Cells:
    """Return the cells (N, 2) that are black in a keep-out mask of the size of the map.

    Raises:
        FormatError: It is no picture, or of another size.
    """
    dark = (255.0 - _pixels(path, parts).mean(axis=2)) / 255.0
    return _cells(dark > OCCUPIED_THRESHOLD, parts)


def _pixels(path: Path, parts: Parts) -> Grey:
    """Return the picture (rows, cols, 3), its first row the highest y."""
    must = Image.open(io.BytesIO(parts.picture)).size
    try:
        with Image.open(path) as picture:
            size = picture.size
            pixels = np.asarray(picture.convert("RGB"))
    except (UnidentifiedImageError, SyntaxError, ValueError, EOFError) as error:
        raise FormatError(path, "no picture, must be PGM or PNG") from error
    if size != must:
        raise FormatError(
            path,
            f"{size[0]} x {size[1]} pixels, must be {must[0]} x {must[1]} as map.pgm; map.png has margins"
            " and cannot be painted on",
        )
    return pixels


def _cells(mask: NDArray[np.bool_], parts: Parts) -> Cells:
    rows, cols = np.nonzero(mask[::-1])
    x, y = parts.origin_m
    low = np.round(np.array((y, x)) / parts.resolution_m).astype(np.int64)
    return np.column_stack((rows, cols)).astype(np.int64) + low
