"""Floors of offices drawn by chance: corridors in a grid, rooms along them, furniture, people who walk.

Nothing is measured here. Every seed is another building and another way, so no setting can be fitted to one.
The same seed gives the same floor.
"""

import sys
from collections import Counter
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

from drivers.world import Building, Laser, box, outline
from drivers.world.building import Rectangle
from tests.people import Peopled, Person

WALL_M = 0.2
RECESS_M = 0.1
OPEN, CLOSED = 0.5, 0.85
"""Share of the rooms with an open door; up to the second one, a closed one; the others show nothing."""
CLEAR_M = 0.6
"""Between the way and whatever stands in a room."""


@dataclass(slots=True)
class _Floor:
    """What a floor is drawn of."""

    rng: np.random.Generator
    across: list[tuple[float, float]]
    """Lower and upper edge of each corridor along x."""
    along: list[tuple[float, float]]
    """Left and right edge of each corridor along y."""
    free: list[Rectangle] = field(default_factory=list)
    rooms: list[Rectangle] = field(default_factory=list)
    doors: dict[tuple[int, int], list[tuple[float, float]]] = field(default_factory=dict)
    """By corridor along x and column of blocks: places in the rooms, straight behind their open doors."""


@dataclass(frozen=True, slots=True)
class Size:
    """How wide the corridors are and how far apart: least and most, m."""

    width_m: tuple[float, float]
    apart_m: tuple[float, float]


OFFICES = Size((1.6, 3.0), (8.0, 20.0))
CAMPUS = Size((1.8, 4.0), (40.0, 110.0))
"""Corridors of a hundred metres and more, as between the buildings of a university."""


def floor_plan(seed: int, way_m: float = 200.0, size: Size = OFFICES) -> Building:
    """Return a floor of two or three corridors each way, and a way through it of at least `way_m`."""
    rng = np.random.default_rng(seed)
    floor = _Floor(rng, _lanes(rng, size), _lanes(rng, size))
    across, along = floor.across, floor.along
    right, top = along[-1][1], across[-1][1]
    floor.free += [(0.0, low, right, high) for low, high in across]
    floor.free += [(low, 0.0, high, top) for low, high in along]
    for row, (_, below) in enumerate(across[:-1]):
        for column, (_, left) in enumerate(along[:-1]):
            block = (left, below, along[column + 1][0], across[row + 1][0])
            _cut_block(floor, block, row, column)
            floor.free += _niches(rng, block[1], block[3], x=(block[0], 1.0))
            floor.free += _niches(rng, block[1], block[3], x=(block[2], -1.0))
    if rng.random() < 0.75:
        floor.free += _niches(rng, 0.0, top, x=(0.0, -1.0)) + _niches(rng, 0.0, top, x=(right, 1.0))
        floor.free += _niches(rng, 0.0, right, y=(0.0, -1.0)) + _niches(rng, 0.0, right, y=(top, 1.0))
    route = _way(floor, way_m)
    pieces, pillars = _furniture(floor, route)
    return Building(
        np.vstack((outline(floor.free), *pieces)),
        pillars=np.array(pillars).reshape(-1, 3),
        route=route,
        name=f"floor plan {seed}",
    )


def _lanes(rng: np.random.Generator, size: Size) -> list[tuple[float, float]]:
    """Return the edges of the parallel corridors of one direction."""
    at, lanes = 0.0, []
    for _ in range(rng.integers(2, 4)):
        width = rng.uniform(*size.width_m)
        lanes.append((at, at + width))
        at += width + rng.uniform(*size.apart_m)
    return lanes


def _niches(rng: np.random.Generator, low: float, high: float, *, x=None, y=None) -> list[Rectangle]:
    """Return closed doors and windows, as deep as a hand or less, at unequal gaps along one wall.

    `x` or `y`: where the wall is, and in which direction the niches go.
    """
    found, at = [], low + rng.uniform(1.0, 6.0)
    while at < high - 1.5:
        end, deep = at + rng.uniform(0.6, 1.4), rng.choice((0.06, 0.1, 0.15))
        place, sign = x or y
        near, far = sorted((place, place + sign * deep))
        found.append((near, at, far, end) if x else (at, near, end, far))
        at = end + rng.uniform(1.0, 6.0)
    return found


def _cut_block(floor: _Floor, block: Rectangle, row: int, column: int) -> None:
    """Cut a block into two rows of rooms, with doors to the corridors below and above."""
    (x0, y0, x1, y1), rng = block, floor.rng
    middle = y0 + (y1 - y0) * rng.uniform(0.35, 0.65)
    for upper in (False, True):
        low, high = (middle + WALL_M / 2, y1 - WALL_M) if upper else (y0 + WALL_M, middle - WALL_M / 2)
        wall, recess = ((high, y1), (y1 - RECESS_M, y1)) if upper else ((y0, low), (y0, y0 + RECESS_M))
        at = x0 + WALL_M
        while at < x1 - 2.5:
            end = min(at + rng.uniform(2.8, 7.0), x1 - WALL_M)
            if x1 - WALL_M - end < 2.5:
                end = x1 - WALL_M
            kind, door = rng.random(), rng.uniform(at + 0.3, max(end - 1.2, at + 0.31))
            if kind < OPEN:
                floor.rooms.append((at, low, end, high))
                floor.free += [(at, low, end, high), (door, wall[0], door + 0.9, wall[1])]
                depth = min(2.0, (high - low) / 2)
                inside = (door + 0.45, high - depth if upper else low + depth)
                floor.doors.setdefault((row + upper, column), []).append(inside)
            elif kind < CLOSED:
                floor.free.append((door, recess[0], door + 0.9, recess[1]))
            at = end + WALL_M


def _way(floor: _Floor, way_m: float) -> NDArray[np.float64]:
    """Walk from crossing to crossing, into the rooms on the way, rather where one has not been."""
    rng = floor.rng
    ys, xs = ([sum(lane) / 2 for lane in lanes] for lanes in (floor.across, floor.along))
    here = (int(rng.integers(len(ys))), int(rng.integers(len(xs))))
    points = [(xs[here[1]], ys[here[0]])]
    walked: Counter[frozenset] = Counter()
    been: set[tuple[float, float]] = set()
    length, before = 0.0, None
    while length < way_m:
        options = [(here[0] + a, here[1] + b) for a, b in ((0, 1), (0, -1), (1, 0), (-1, 0))]
        options = [o for o in options if 0 <= o[0] < len(ys) and 0 <= o[1] < len(xs) and o != before]
        counts = np.array([walked[frozenset((here, o))] for o in options])
        there = options[int(rng.choice(np.flatnonzero(counts == counts.min())))]
        walked[frozenset((here, there))] += 1
        if here[0] == there[0]:
            stops = floor.doors.get((here[0], min(here[1], there[1])), [])
            for x, y in sorted(stops, reverse=there[1] < here[1]):
                if (x, y) not in been and rng.random() < 0.4:
                    been.add((x, y))
                    points += [(x, ys[here[0]]), (x, y), (x, ys[here[0]])]
        points.append((xs[there[1]], ys[there[0]]))
        length = float(np.hypot(*np.diff(np.array(points), axis=0).T).sum())
        before, here = here, there
    return np.array(points)


def _furniture(floor: _Floor, route: NDArray[np.float64]) -> tuple[list, list]:
    """Put boxes, and tables and chairs on four legs, where the way leaves room for them."""
    rng = floor.rng
    fine = np.concatenate(
        [np.linspace(a, b, max(2, int(np.hypot(*(b - a)) / 0.2))) for a, b in pairwise(route)]
    )
    pieces, pillars = [], []
    for x0, y0, x1, y1 in floor.rooms:
        for _ in range(rng.integers(1, 6)):
            wide, deep = rng.uniform(0.4, 2.0), rng.uniform(0.4, 1.0)
            if wide > x1 - x0 - 0.2 or deep > y1 - y0 - 0.2:
                continue
            x = rng.uniform(x0, x1 - wide)
            y = rng.choice((y0, y1 - deep, rng.uniform(y0, y1 - deep)))
            near = np.maximum(np.abs(fine - (x + wide / 2, y + deep / 2)) - (wide / 2, deep / 2), 0.0)
            if np.hypot(*near.T).min() < CLEAR_M:
                continue
            if rng.random() < 0.6:
                pieces.append(box(x, y, x + wide, y + deep))
            else:
                legs = ((x, y), (x + wide, y), (x, y + deep), (x + wide, y + deep))
                pillars += [(a, b, rng.uniform(0.015, 0.04)) for a, b in legs]
    return pieces, pillars


def crowded(laser: Laser, building: Building, people: int, seed: int) -> Peopled:
    """Return a laser among so many people, who walk to and fro along the way through a building."""
    rng = np.random.default_rng(seed)
    lengths = np.hypot(*np.diff(building.route, axis=0).T)
    legs = np.flatnonzero(lengths > 4.0)
    walkers = []
    for number in rng.choice(legs, people):
        start, end = building.route[number], building.route[number + 1]
        aside = np.array((start[1] - end[1], end[0] - start[0])) / lengths[number] * rng.choice((-0.45, 0.45))
        walkers.append(
            Person(
                start=start + aside,
                end=end + aside,
                speed_mps=rng.uniform(0.7, 1.4),
                ahead_m=rng.uniform(0.0, 50.0),
            )
        )
    return Peopled(laser, walkers)
