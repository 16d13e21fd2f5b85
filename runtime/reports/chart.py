"""Small charts as SVG text: lines over time, a strip of states, a cloud of poses; bounded in size."""

import html
import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

WIDTH, HEIGHT = 960, 150
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 8, 26, 22
_TREE_HEIGHT = 260
_BINS = 600
_INKS = ("#d62828", "#2663d6", "#168754")


def lines(
    x: NDArray[np.float64],
    series: Mapping[str, ArrayLike],
    title: str,
    *,
    low: float | None = None,
    high: float | None = None,
    unit: str = "s",
) -> str:
    """Draw one or more values over rising x (N,); gaps where they are not finite.

    Of many values in one place the least and the greatest are drawn, so that no peak is lost.
    """
    values, finite = _numbers(series)
    bottom = low if low is not None else (float(finite.min()) if finite.size else 0.0)
    top = high if high is not None else (float(finite.max()) if finite.size else 1.0)
    top = top if top > bottom else bottom + 1.0
    return _drawn(x, values, title, {bottom: f"{bottom:.3g}", top: f"{top:.3g}"}, unit)


def decades(x: NDArray[np.float64], series: Mapping[str, ArrayLike], title: str, *, unit: str = "s") -> str:
    """Draw one or more positive values over rising x (N,) on a logarithmic scale; see `lines`.

    The scale begins four decades below its end at most: what is less is drawn at its foot.
    """
    values, finite = _numbers(series)
    positive = finite[finite > 0.0]
    top = math.ceil(np.log10(positive.max())) if positive.size else 1
    bottom = max(math.floor(np.log10(positive.min())), top - 4) if positive.size else 0
    bottom = min(bottom, top - 1)
    exponents = {name: np.log10(np.maximum(value, 10.0**bottom)) for name, value in values.items()}
    marks = {float(power): f"{10.0**power:g}" for power in range(bottom, top + 1)}
    return _drawn(x, exponents, title, marks, unit)


def _numbers(
    series: Mapping[str, ArrayLike],
) -> tuple[dict[str, NDArray[np.float64]], NDArray[np.float64]]:
    """Return the series as arrays, and all of their finite values together."""
    values = {name: np.asarray(value, dtype=np.float64) for name, value in series.items()}
    return values, np.concatenate([value[np.isfinite(value)] for value in values.values()])


def _drawn(
    x: NDArray[np.float64],
    values: Mapping[str, NDArray[np.float64]],
    title: str,
    marks: Mapping[float, str],
    unit: str,
) -> str:
    """Draw lines in a frame from the least to the greatest of `marks`, values with their texts."""
    bottom, top = min(marks), max(marks)
    body = [_frame(title, x, marks, unit)]
    for (name, value), ink in zip(values.items(), _INKS, strict=False):
        for stretch in _stretches(x, value):
            path = " ".join(f"{_x(a, x):.1f},{_y(b, bottom, top):.1f}" for a, b in stretch)
            body.append(f'<polyline fill="none" stroke="{ink}" stroke-width="1.2" points="{path}"/>')
        if len(values) > 1:
            place = WIDTH - _RIGHT - 130 * (len(values) - list(values).index(name))
            body.append(f'<text x="{place}" y="16" fill="{ink}" font-size="13">{html.escape(name)}</text>')
    return _svg(HEIGHT, body)


def strip(x: NDArray[np.float64], states: ArrayLike, colours: Mapping[str, str]) -> str:
    """Draw which state held when, as a coloured bar."""
    words = np.asarray(states)
    body = []
    for begin, last in spells(words):
        # Up to where the next one begins: what lies between two scans belongs to the earlier one.
        at, until = round(_x(x[begin], x)), round(_x(x[min(last + 1, len(words) - 1)], x))
        colour = colours.get(str(words[begin]), "#888")
        # A single lost scan of a long run must still be seen.
        width = max(until - at, 1)
        body.append(f'<rect x="{at}" y="4" width="{width}" height="16" fill="{colour}"/>')
    return _svg(24, list(dict.fromkeys(body)))  # of many in one place only one is drawn


def spells(states: NDArray[np.str_]) -> list[tuple[int, int]]:
    """Return the first and the last index of each spell of equal states (N,), in order."""
    if len(states) == 0:
        return []
    edges = np.flatnonzero(states[1:] != states[:-1])
    return list(zip([0, *(edges + 1).tolist()], [*edges.tolist(), len(states) - 1], strict=True))


def cloud(poses: NDArray[np.float64], title: str) -> str:
    """Draw poses (P, 3) as strokes, with equal scales, x to the right and y up; down to a millimetre."""
    size = 320
    centre = (poses[:, :2].min(axis=0) + poses[:, :2].max(axis=0)) / 2
    reach = max(float(np.abs(poses[:, :2] - centre).max()), 0.005) * 1.3
    scale = (size / 2 - 30) / reach
    body = [
        f'<rect x="1" y="1" width="{size - 2}" height="{size - 2}" fill="none" stroke="#c4cad0"/>',
        f'<text x="8" y="18" font-size="13">{html.escape(title)}</text>',
    ]
    for x, y, yaw in poses:
        a, b = size / 2 + (x - centre[0]) * scale, size / 2 - (y - centre[1]) * scale
        c, d = a + 12 * np.cos(yaw), b - 12 * np.sin(yaw)
        body.append(f'<path d="M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" stroke="#8c3caa" stroke-opacity=".6"/>')
        body.append(f'<circle cx="{a:.1f}" cy="{b:.1f}" r="2" fill="#8c3caa"/>')
    bar = 10.0 ** np.floor(np.log10(reach))
    end = 8 + bar * scale
    length = f"{bar:g} m" if bar >= 1.0 else f"{1e3 * bar:g} mm"
    body.append(f'<path d="M8 {size - 10}H{end:.1f}" stroke="#464e58" stroke-width="2"/>')
    body.append(f'<text x="{end + 6:.1f}" y="{size - 5}" font-size="13">{length}</text>')
    return _svg(size, body, size)


def tree(ancestors: NDArray[np.int16], title: str) -> str:
    """Draw who descends from whom, from left to right.

    Args:
        ancestors: (P, K) of each of P, at each of K times; equal numbers at one time are the same ancestor.
        title: Over the picture.
    """
    count, times = ancestors.shape
    order = np.lexsort(ancestors.T[::-1])  # relatives beside each other, those of long ago first
    family = ancestors[order].astype(np.int64)
    # Who has the same ancestor at a time shares its place: the middle of all descendants.
    ranks = np.arange(count, dtype=np.float64)
    places = np.empty((count, times))
    for time in range(times):
        _, whose, members = np.unique(family[:, time], return_inverse=True, return_counts=True)
        places[:, time] = (np.bincount(whose, ranks) / members)[whose]
    across = _LEFT + (WIDTH - _LEFT - _RIGHT) * np.arange(times) / max(times - 1, 1)
    down = _TOP + (_TREE_HEIGHT - _TOP - 12) * (places + 0.5) / count
    body = [f'<text x="{_LEFT}" y="16" font-size="13">{html.escape(title)}</text>']
    for row in range(count):
        apart = np.flatnonzero(family[row] != family[row - 1]) if row else np.arange(times)
        if len(apart):
            begin = max(int(apart[0]) - 1, 0)
            line = " ".join(
                f"{x:.1f},{y:.1f}" for x, y in zip(across[begin:], down[row, begin:], strict=True)
            )
            body.append(f'<polyline fill="none" stroke="#8c3caa" stroke-opacity=".7" points="{line}"/>')
    return _svg(_TREE_HEIGHT, body)


def _stretches(x: NDArray[np.float64], value: NDArray[np.float64]) -> list[list[tuple[float, float]]]:
    """Split at what is not finite, and thin to the extremes of each bin."""
    if len(x) == 0:
        return []
    span = max(float(x[-1] - x[0]), 1e-9)
    bins = np.minimum(((x - x[0]) / span * _BINS).astype(int), _BINS - 1)
    found: list[list[tuple[float, float]]] = []
    good = np.isfinite(value)
    edges = np.flatnonzero(np.r_[True, good[1:] != good[:-1], True])
    for begin, end in itertools.pairwise(edges):
        if not good[begin]:
            continue
        points: list[tuple[float, float]] = []
        inner = np.flatnonzero(np.r_[True, np.diff(bins[begin:end]) != 0, True]) + begin
        for first, last in itertools.pairwise(inner):
            lowest = first + int(np.argmin(value[first:last]))
            highest = first + int(np.argmax(value[first:last]))
            for at in sorted({lowest, highest}):
                points.append((float(x[at]), float(value[at])))
        found.append(points)
    return found[: 2 * _BINS]


def _x(value: float, x: NDArray[np.float64]) -> float:
    span = max(float(x[-1] - x[0]), 1e-9) if len(x) else 1.0
    return _LEFT + (WIDTH - _LEFT - _RIGHT) * (float(value) - float(x[0])) / span


def _y(value: float, bottom: float, top: float) -> float:
    share = min(max((value - bottom) / (top - bottom), 0.0), 1.0)
    return HEIGHT - _BOTTOM - (HEIGHT - _TOP - _BOTTOM) * share


def _frame(title: str, x: NDArray[np.float64], marks: Mapping[float, str], unit: str) -> str:
    floor, ceiling = HEIGHT - _BOTTOM, _TOP
    bottom, top = min(marks), max(marks)
    text = 'font-size="12" fill="#5a6470"'
    first, last = (float(x[0]), float(x[-1])) if len(x) else (0.0, 0.0)
    heights = {mark: _y(mark, bottom, top) for mark in marks}
    across = "".join(
        f"M{_LEFT} {heights[mark]:.0f}H{WIDTH - _RIGHT}" for mark in marks if bottom < mark < top
    )
    words = "".join(
        f'<text x="{_LEFT - 6}" y="{heights[mark] + (8 if mark == top else 0 if mark == bottom else 4):.0f}" '
        f'text-anchor="end" {text}>{word}</text>'
        for mark, word in marks.items()
    )
    return (
        f'<text x="{_LEFT}" y="16" font-size="13">{html.escape(title)}</text>'
        + (f'<path d="{across}" fill="none" stroke="#eceef0"/>' if across else "")
        + f'<path d="M{_LEFT} {ceiling}V{floor}H{WIDTH - _RIGHT}" fill="none" stroke="#c4cad0"/>'
        f"{words}"
        f'<text x="{_LEFT}" y="{HEIGHT - 6}" {text}>{first:.0f} {unit}</text>'
        f'<text x="{WIDTH - _RIGHT}" y="{HEIGHT - 6}" text-anchor="end" {text}>{last:.0f} {unit}</text>'
    )


def _svg(height: int, body: Sequence[str], width: int = WIDTH) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {height}" width="{width}" '
        f'height="{height}" font-family="system-ui, sans-serif">{"".join(body)}</svg>'
    )
