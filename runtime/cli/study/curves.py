"""A few lines over a common axis, as a picture."""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from runtime.reports.picture import FREE, GUESSES, HITS, INK, PATH, START, TRUTH, round_step

_COLOURS = (PATH, GUESSES, HITS, START)
_FINE = 2
_LEFT, _TOP, _BOTTOM, _RIGHT = 44, 34, 40, 14


def plot(curves: Mapping[str, NDArray[np.float64]], title: str, size_px: int) -> Image.Image:
    """Draw each curve (N,) over its index; the axes reach from nothing to the greatest of all.

    Args:
        curves: By name, at most four, none of them negative; one has two values or more.
        title: Over the picture.
        size_px: Of both sides.
    """
    size = size_px * _FINE
    picture = Image.new("RGB", (size, size), FREE)
    draw = ImageDraw.Draw(picture)
    font = ImageFont.load_default(13 * _FINE)
    left, top, right, bottom = (
        _LEFT * _FINE,
        _TOP * _FINE,
        size - _RIGHT * _FINE,
        size - _BOTTOM * _FINE,
    )
    last = max(len(curve) for curve in curves.values()) - 1
    most = max(1.05 * max(float(np.max(curve)) for curve in curves.values()), 1e-12)
    for value in ticks(most):
        level = bottom - value / most * (bottom - top)
        draw.line((left, level, right, level), fill=(226, 230, 234), width=_FINE)
        draw.text((left - 5 * _FINE, level), f"{value:g}", fill=INK, font=font, anchor="rm")
    for value in ticks(last):
        across = left + value / last * (right - left)
        draw.text((across, bottom + 12 * _FINE), f"{value:g}", fill=INK, font=font, anchor="mm")
    draw.line((left, top, left, bottom, right, bottom), fill=TRUTH, width=_FINE)
    draw.text((left, top // 2), title, fill=INK, font=ImageFont.load_default(15 * _FINE), anchor="lm")
    for number, ((name, curve), colour) in enumerate(zip(curves.items(), _COLOURS, strict=False)):
        x = left + np.arange(len(curve)) / max(last, 1) * (right - left)
        y = bottom - np.asarray(curve) / most * (bottom - top)
        draw.line(list(zip(x.tolist(), y.tolist(), strict=True)), fill=colour, width=2 * _FINE, joint="curve")
        level = bottom - (18 * (len(curves) - number)) * _FINE
        draw.line((right - 150 * _FINE, level, right - 130 * _FINE, level), fill=colour, width=3 * _FINE)
        draw.text((right - 124 * _FINE, level), name, fill=INK, font=font, anchor="lm")
    return picture.resize((size_px, size_px), Image.Resampling.BOX)


def ticks(most: float) -> list[float]:
    """Return the multiples from 0 to `most` of a round step (1, 2 or 5 times a power of ten): four to eight.

    Args:
        most: End of the axis, positive.
    """
    step = round_step(most / 3.0)
    return [number * step for number in range(int(most / step + 1e-9) + 1)]
