"""A map as a picture for people: what is known, where the laser went, and how long a metre is.

Plain arrays in, an image out; the same arrays give the same bytes.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from PIL import Image, ImageDraw, ImageFont

UNKNOWN = (226, 230, 234)
FREE = (255, 255, 255)
WALL = (28, 36, 48)
PATH = (214, 40, 40)
HITS = (38, 99, 214)
TRUTH = (120, 128, 136)
GUESSES = (178, 132, 198)
START = (22, 135, 84)
INK = (70, 78, 88)
KEPT_OUT = (222, 70, 70)
"""Laid thinly over the ground that a robot shall keep out of."""

_FINE = 2
"""Everything is drawn at this multiple and shrunk once, which smooths lines and letters."""
_STRIP_PX, _LINE_PX = 44, 22
"""Height of the strip under a map, and of each line of a caption that does not fit into it."""


@dataclass(frozen=True, slots=True)
class _Frame:
    """Where the picture lies in the map: `corner_m` is the lower left corner of its lowest left cell."""

    corner_m: tuple[float, float]
    px_per_m: float
    height_px: int

    def px(self, points_map: NDArray[np.float64]) -> list[tuple[float, float]]:
        """Return pixels of points (N, 2+) m, finely drawn, y down."""
        x = (points_map[:, 0] - self.corner_m[0]) * self.px_per_m
        y = self.height_px - (points_map[:, 1] - self.corner_m[1]) * self.px_per_m
        return list(zip(x.tolist(), y.tolist(), strict=True))


def render(
    probability: NDArray[np.float32],
    resolution_m: float,
    origin_m: tuple[float, float],
    trajectory: ArrayLike | None = None,
    *,
    truth: ArrayLike | None = None,
    others: Sequence[NDArray[np.float64]] = (),
    hits: ArrayLike | None = None,
    hit_px: float = 1.0,
    keep_out: NDArray[np.bool_] | None = None,
    caption: str = "",
    size_px: int = 1400,
    margin_m: float = 0.5,
    bounds_m: tuple[float, float, float, float] | None = None,
) -> Image.Image:
    """Draw a map seen from above, x to the right and y up.

    Args:
        probability: (rows, cols) of occupancy in [0, 1], NaN where unknown; row 0 has the lowest y.
        resolution_m: Edge of a cell.
        origin_m: Lower left corner of cell (0, 0), map frame.
        trajectory: (N, 2) or (N, 3) path of the laser, m, map frame: red, with a start ring and an end arrow.
        truth: (N, 2) or (N, 3) path to compare with, drawn in grey under the trajectory.
        others: Ways (K, 2) of other guesses, drawn thinly in purple under the trajectory.
        hits: (M, 2) measured points, m, map frame, drawn in blue.
        hit_px: Half the edge of each hit.
        keep_out: (rows, cols) ground that a robot shall keep out of, tinted red.
        caption: Under the map, in Latin letters; one line where there is room for it.
        size_px: Longest side of the map in the picture; the cells are whole pixels where they fit.
        margin_m: Ground kept around what is known.
        bounds_m: Least x and y, greatest x and y to show, map frame; whatever is known or drawn if None.

    Raises:
        ValueError: `probability` is not two-dimensional, `keep_out` has another shape, or `resolution_m` is
            not positive.
    """
    if probability.ndim != 2 or probability.size == 0:
        raise ValueError(f"probability has shape {probability.shape}, must be (rows, cols)")
    if not resolution_m > 0.0:
        raise ValueError(f"resolution_m = {resolution_m}, must be positive")
    if keep_out is not None and keep_out.shape != probability.shape:
        raise ValueError(f"keep_out has shape {keep_out.shape}, must be {probability.shape}")
    path, path_truth, points = (_points(a) for a in (trajectory, truth, hits))
    guessed = [_points(way) for way in others]
    if bounds_m is None:
        cells = _extent(probability, resolution_m, origin_m, (path, path_truth, points, *guessed), margin_m)
    else:
        cells = (np.array(bounds_m).reshape(2, 2) - origin_m)[:, ::-1] / resolution_m
    kept = keep_out if keep_out is not None and keep_out.any() else None
    canvas, frame = _ground(probability, resolution_m, origin_m, cells, kept, size_px)
    draw = ImageDraw.Draw(canvas)
    for way in guessed:
        if len(way) > 1:
            draw.line(frame.px(way), fill=GUESSES, width=_FINE)
    _draw_paths(draw, frame, path, path_truth, points, hit_px * _FINE)
    return _with_legend(canvas, frame, caption, marked=len(path) > 0, kept=kept is not None)


def _ground(
    probability: NDArray[np.float32],
    resolution_m: float,
    origin_m: tuple[float, float],
    cells: NDArray[np.float64],
    kept: NDArray[np.bool_] | None,
    size_px: int,
) -> tuple[Image.Image, _Frame]:
    """Draw the cells in a window, finely, and say where in the map they lie; see `render`.

    Args:
        probability: (rows, cols).
        resolution_m: Edge of a cell.
        origin_m: Lower left corner of cell (0, 0), map frame.
        cells: (2, 2) least and greatest row and column of the window.
        kept: (rows, cols) ground to keep out of, if there is any.
        size_px: Longest side of the window in the picture.
    """
    window, corner_m = _window(probability, resolution_m, origin_m, cells)
    shrink = max(1, -(-max(window.shape) // size_px))
    window = _coarse(window, shrink)
    colours = _colours(window)
    if kept is not None:
        shown = np.where(kept, np.float32(1.0), np.float32(np.nan))
        shown, _ = _window(shown, resolution_m, origin_m, cells)
        colours = _tinted(colours, ~np.isnan(_coarse(shown, shrink)))
    cell_px = max(1, size_px // max(window.shape))
    rows, cols = window.shape
    size = (cols * cell_px * _FINE, rows * cell_px * _FINE)
    canvas = Image.fromarray(colours[::-1]).resize(size, Image.Resampling.NEAREST)
    return canvas, _Frame(corner_m, cell_px * _FINE / (resolution_m * shrink), canvas.height)


def png(image: Image.Image) -> bytes:
    """Encode a picture; the same pixels give the same bytes."""
    file = io.BytesIO()
    image.save(file, "PNG", optimize=True)
    return file.getvalue()


def round_step(at_most: float) -> float:
    """Return the greatest of ..., 0.5, 1, 2, 5, 10, ... that is not above a positive number."""
    decade = 10.0 ** np.floor(np.log10(at_most))
    return float(max(step * decade for step in (1.0, 2.0, 5.0) if step * decade <= at_most * 1.0001))


def _points(points: ArrayLike | None) -> NDArray[np.float64]:
    array = np.zeros((0, 2)) if points is None else np.asarray(points, dtype=np.float64)
    array = array.reshape(-1, array.shape[-1])[:, :2] if array.size else np.zeros((0, 2))
    return array[np.isfinite(array).all(axis=1)]


def _extent(
    probability: NDArray[np.float32],
    resolution_m: float,
    origin_m: tuple[float, float],
    drawn: tuple[NDArray[np.float64], ...],
    margin_m: float,
) -> NDArray[np.float64]:
    """Return least and greatest row and column (2, 2) of what is known or drawn, with the margin."""
    known = np.argwhere(~np.isnan(probability)).astype(np.float64)  # (K, 2) row, col
    cells = [(d[:, ::-1] - np.array(origin_m)[::-1]) / resolution_m for d in drawn]
    spots = np.vstack([known, known + 1.0, *cells])
    if len(spots) == 0:
        spots = np.array(((0.0, 0.0), probability.shape))
    margin = margin_m / resolution_m
    return np.stack((spots.min(axis=0) - margin, spots.max(axis=0) + margin))


def _window(
    probability: NDArray[np.float32],
    resolution_m: float,
    origin_m: tuple[float, float],
    extent: NDArray[np.float64],
) -> tuple[NDArray[np.float32], tuple[float, float]]:
    """Cut out, or extend to, least and greatest row and column; return cells and lower left corner."""
    low, high = np.floor(extent[0]).astype(int), np.ceil(extent[1]).astype(int)
    window = np.full(tuple(high - low), np.nan, dtype=np.float32)
    inner_low, inner_high = np.maximum(low, 0), np.minimum(high, probability.shape)
    if (inner_low < inner_high).all():
        (r0, c0), (r1, c1) = inner_low - low, inner_high - low
        window[r0:r1, c0:c1] = probability[inner_low[0] : inner_high[0], inner_low[1] : inner_high[1]]
    return window, (origin_m[0] + float(low[1]) * resolution_m, origin_m[1] + float(low[0]) * resolution_m)


def _coarse(window: NDArray[np.float32], shrink: int) -> NDArray[np.float32]:
    """Merge blocks of cells; a block shows its most occupied cell, so that thin walls survive."""
    if shrink == 1:
        return window
    rows, cols = (-(-n // shrink) * shrink for n in window.shape)
    padded = np.full((rows, cols), -1.0, dtype=np.float32)  # below any probability: unknown
    # Rows grow upwards from the corner, so the padding belongs at the far ends.
    padded[: window.shape[0], : window.shape[1]] = np.where(np.isnan(window), np.float32(-1.0), window)
    merged = padded.reshape(rows // shrink, shrink, cols // shrink, shrink).max(axis=(1, 3))
    return np.where(merged < 0.0, np.float32(np.nan), merged).astype(np.float32)


def _colours(window: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Return (rows, cols, 3): white where free, ink where occupied, pale grey where unknown."""
    # Sixteen shades are as many as an eye tells apart here, and keep the file small.
    occupied = np.round(np.clip(np.nan_to_num(window, nan=0.0), 0.0, 1.0) * 16.0)[..., None] / 16.0
    shade = np.asarray(FREE) + occupied * (np.asarray(WALL, dtype=np.float64) - np.asarray(FREE))
    return np.where(np.isnan(window)[..., None], np.asarray(UNKNOWN), np.round(shade)).astype(np.uint8)


def _tinted(colours: NDArray[np.uint8], where: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return colours (rows, cols, 3) with a thin red over some of the cells (rows, cols)."""
    tinted = 0.6 * colours + 0.4 * np.asarray(KEPT_OUT, dtype=np.float64)
    return np.where(where[..., None], np.round(tinted), colours).astype(np.uint8)


def _draw_paths(
    draw: ImageDraw.ImageDraw,
    frame: _Frame,
    path: NDArray[np.float64],
    truth: NDArray[np.float64],
    hits: NDArray[np.float64],
    hit_px: float,
) -> None:
    for x, y in frame.px(hits):
        draw.rectangle((x - hit_px, y - hit_px, x + hit_px, y + hit_px), fill=HITS)
    if len(truth) > 1:
        draw.line(frame.px(truth), fill=TRUTH, width=2 * _FINE, joint="curve")
    if len(path) == 0:
        return
    if len(path) > 1:
        draw.line(frame.px(path), fill=PATH, width=2 * _FINE, joint="curve")
    start, end = frame.px(path[[0, -1]])
    _ring(draw, start)
    _arrow(draw, end, _heading(path))


def _heading(path: NDArray[np.float64]) -> float:
    """Return the direction in which the path last moved by 0.1 m, rad; 0 for one that never did."""
    far = np.flatnonzero(np.hypot(*(path[-1] - path).T) > 0.1)
    if len(far) == 0:
        return 0.0
    step = path[-1] - path[far[-1]]
    return float(np.arctan2(step[1], step[0]))


def _ring(draw: ImageDraw.ImageDraw, at: tuple[float, float]) -> None:
    for radius, colour in ((9, FREE), (7, START), (3.5, FREE)):
        r = radius * _FINE
        draw.ellipse((at[0] - r, at[1] - r, at[0] + r, at[1] + r), fill=colour)


def _arrow(draw: ImageDraw.ImageDraw, at: tuple[float, float], heading_rad: float) -> None:
    for size, colour in ((13.0, FREE), (9.0, PATH)):
        corners = [
            (
                at[0] + size * _FINE * np.cos(heading_rad + turn) * reach,
                at[1] - size * _FINE * np.sin(heading_rad + turn) * reach,
            )
            for turn, reach in ((0.0, 1.25), (2.5, 1.0), (np.pi, 0.35), (-2.5, 1.0))
        ]
        draw.polygon(corners, fill=colour)


def _with_legend(
    canvas: Image.Image, frame: _Frame, caption: str, *, marked: bool, kept: bool
) -> Image.Image:
    """Put a strip under the map: scale bar, caption, and on the right what the marks mean.

    A caption that is too long for its place beside the bar stands in lines of its own under it.
    """
    font = ImageFont.load_default(15 * _FINE)
    bar_m = round_step(0.25 * canvas.width / frame.px_per_m)
    left, level = 16 * _FINE, canvas.height + _STRIP_PX * _FINE // 2
    right = left + bar_m * frame.px_per_m
    text = f"{bar_m:g} m" + (f"     {caption}" if caption else "")
    below: list[str] = []
    if right + 12 * _FINE + font.getlength(text) > canvas.width - 8 * _FINE:
        text, below = f"{bar_m:g} m", _wrapped(caption, font, canvas.width - 2 * left)
    longest = max((font.getlength(line) for line in below), default=0.0)
    # A whole number of picture pixels after the shrinking; a word that is wider than the map widens the page.
    asked = (max(canvas.width, round(longest) + 2 * left), canvas.height + _STRIP_PX * _FINE)
    width, height = (-(-n // _FINE) * _FINE for n in asked)
    page = Image.new("RGB", (width, height + len(below) * _LINE_PX * _FINE), FREE)
    page.paste(canvas, (0, 0))
    draw = ImageDraw.Draw(page)
    draw.line((left, level, right, level), fill=INK, width=2 * _FINE)
    for x in (left, right):
        draw.line((x, level - 6 * _FINE, x, level + 6 * _FINE), fill=INK, width=2 * _FINE)
    draw.text((right + 12 * _FINE, level), text, fill=INK, font=font, anchor="lm")
    for number, line in enumerate(below, start=1):
        draw.text((left, level + number * _LINE_PX * _FINE), line, fill=INK, font=font, anchor="lm")
    taken = right + 12 * _FINE + draw.textlength(text, font=font)
    if kept and canvas.width - taken > 262 * _FINE:
        at, edge = canvas.width - 236 * _FINE, 7 * _FINE
        pale = _tinted(np.full((1, 1, 3), FREE, dtype=np.uint8), np.ones((1, 1), dtype=np.bool_))[0, 0]
        draw.rectangle((at - edge, level - edge, at + edge, level + edge), fill=tuple(pale.tolist()))
        draw.text((at + 12 * _FINE, level), "kept out", fill=INK, font=font, anchor="lm")
    if marked and canvas.width - taken > 150 * _FINE:
        _ring(draw, (canvas.width - 128 * _FINE, level))
        draw.text((canvas.width - 112 * _FINE, level), "start", fill=INK, font=font, anchor="lm")
        _arrow(draw, (canvas.width - 58 * _FINE, level), 0.0)
        draw.text((canvas.width - 40 * _FINE, level), "end", fill=INK, font=font, anchor="lm")
    return page.resize((page.width // _FINE, page.height // _FINE), Image.Resampling.BOX)


def _wrapped(text: str, font: "ImageFont.FreeTypeFont | ImageFont.ImageFont", width_px: float) -> list[str]:
    """Break text between words into lines that are no wider, but for a word that is wider itself."""
    lines: list[str] = []
    for word in text.split():
        if lines and font.getlength(f"{lines[-1]} {word}") <= width_px:
            lines[-1] += f" {word}"
        else:
            lines.append(word)
    return lines
