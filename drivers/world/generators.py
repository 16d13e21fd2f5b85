"""Buildings to try things in; each comes with a free way through it.

Lengths in metres.  The lower left corner of every building lies near (0, 0).
"""

import numpy as np

from drivers.world.building import Array, Building, Rectangle, box, outline

DOOR_M = 1.0
"""Width of an open door."""
WALL_M = 0.2
"""Thickness of a wall between two rooms."""
RECESS_M = 0.12
"""How deep a closed door lies behind its wall."""


def corridor(length_m: float = 20.0, width_m: float = 2.0) -> Building:
    """Return a plain corridor along x: nothing in it tells how far one has come."""
    route = np.array(((1.0, width_m / 2), (length_m - 1.0, width_m / 2)))
    return Building(outline([(0.0, 0.0, length_m, width_m)]), route=route, name="corridor")


def hallway_with_doors(length_m: float = 40.0, width_m: float = 2.4, every_m: float = 3.7) -> Building:
    """Return a corridor with closed doors in recesses on both sides, shifted against each other."""
    free: list[Rectangle] = [(0.0, 0.0, length_m, width_m)]
    for number, x in enumerate(np.arange(2.0, length_m - 1.5, every_m)):
        # Unequal gaps: a hallway that repeats exactly would look the same one door further on.
        x += 0.4 * (number % 3)
        free.append((x, -RECESS_M, x + 0.9, 0.0))
        free.append((x + 0.55 * every_m - 0.9, width_m, x + 0.55 * every_m, width_m + RECESS_M))
    free = [(x0, y0, min(x1, length_m), y1) for x0, y0, x1, y1 in free if x0 < length_m]
    route = np.array(((1.0, width_m / 2), (length_m - 1.0, width_m / 2)))
    return Building(outline(free), route=route, name="hallway_with_doors")


def pillar_hall(length_m: float = 16.0, width_m: float = 10.0, every_m: float = 2.5) -> Building:
    """Return a hall with rows of round pillars of several thicknesses; the route winds between them."""
    xs = np.arange(every_m, length_m - every_m / 2, every_m)
    ys = np.arange(every_m, width_m - every_m / 2, every_m)
    radii = (0.15, 0.2, 0.25, 0.3)
    pillars = [(x, y, radii[(3 * i + j) % 4]) for i, x in enumerate(xs) for j, y in enumerate(ys)]
    low, high, left, right = every_m / 2, ys[-1] + every_m / 2, xs[0] - every_m / 2, xs[-1] + every_m / 2
    middle = ys[0] + every_m / 2
    route = np.array(
        ((left, low), (right, low), (right, middle), (left, middle), (left, high), (right, high))
    )
    return Building(
        outline([(0.0, 0.0, length_m, width_m)]), pillars=np.array(pillars), route=route, name="pillar_hall"
    )


def loop_corridor(perimeter_m: float = 100.0, width_m: float = 2.0) -> Building:
    """Return a plain corridor around a block; `perimeter_m` is the length of its centre line."""
    side = perimeter_m / 4.0
    return Building(
        outline(_ring(side, width_m)), route=_ring_route(side, width_m), closed=True, name="loop_corridor"
    )


def square_of_corridors(side_m: float = 40.0, width_m: float = 2.4, every_m: float = 3.7) -> Building:
    """Return four corridors around a block, each `side_m` long on its centre line, with closed doors."""
    free = _ring(side_m, width_m)
    outer = side_m + width_m
    for number, at in enumerate(np.arange(3.5, side_m - 2.0, every_m)):
        at += 0.4 * (number % 3)
        far = outer - at  # opposite corridors are not mirror images of each other
        free += [(at, -RECESS_M, at + 0.9, 0.0), (far - 0.9, outer, far, outer + RECESS_M)]
        free += [(-RECESS_M, far - 1.1, 0.0, far), (outer, at, outer + RECESS_M, at + 1.1)]
        if number % 2 and width_m + 1.0 < at < side_m - 2.0:
            inner = (width_m + RECESS_M, side_m - RECESS_M)
            free += [(width_m, at, inner[0], at + 0.9), (inner[1], far - 0.9, side_m, far)]
            free += [(far - 1.1, width_m, far, inner[0]), (at, inner[1], at + 1.1, side_m)]
    return Building(
        outline(free), route=_ring_route(side_m, width_m), closed=True, name="square_of_corridors"
    )


def room(width_m: float = 6.0, depth_m: float = 5.0, furniture: bool = True) -> Building:
    """Return one room; with furniture a table, a cupboard, a dark sofa and a pillar stand in it."""
    walls = outline([(0.0, 0.0, width_m, depth_m)])
    margin = 1.0
    route = np.array(
        (
            (margin, margin),
            (width_m - margin, margin),
            (width_m - margin, depth_m - margin),
            (margin, depth_m - margin),
        )
    )
    if not furniture:
        return Building(walls, route=route, closed=True, name="room")
    middle_x, middle_y = width_m / 2, depth_m / 2
    pieces = [
        box(middle_x - 0.6, middle_y - 0.35, middle_x + 0.6, middle_y + 0.35),
        box(0.0, middle_y - 0.4, 0.45, middle_y + 0.5),
        box(middle_x + 0.5, depth_m - 0.4, middle_x + 1.4, depth_m),
    ]
    dark = np.repeat([False, False, False, True], [len(walls), 4, 4, 4])
    pillars = np.array(((middle_x - 1.1, middle_y + 0.1, 0.12),))
    return Building(np.vstack((walls, *pieces)), pillars, dark, route, closed=True, name="room")


def doorway(width_m: float = 5.0, depth_m: float = 4.5) -> Building:
    """Return two furnished rooms with an open door between them; the route goes through it and comes back."""
    right, low = width_m + WALL_M, depth_m / 2 - DOOR_M / 2
    free = [
        (0.0, 0.0, width_m, depth_m),
        (right, 0.0, right + width_m, depth_m),
        (width_m, low, right, low + DOOR_M),
    ]
    pieces = [
        box(0.6, depth_m - 0.6, 1.8, depth_m),
        box(width_m - 0.5, 0.0, width_m, 0.9),
        box(right + 1.6, depth_m - 0.45, right + 3.0, depth_m),
        box(right + width_m - 0.6, 0.5, right + width_m, 1.3),
    ]
    middle, far = depth_m / 2, right + width_m - 1.3
    route = np.array(
        (
            (1.2, 1.2),
            (width_m - 1.4, middle),
            (right + 1.4, middle),
            (far, depth_m - 1.3),
            (far - 1.6, 1.2),
            (right + 1.4, middle),
            (width_m - 1.4, middle),
            (1.4, depth_m - 1.5),
            (1.2, 1.2),
        )
    )
    return Building(np.vstack((outline(free), *pieces)), route=route, name="doorway")


def demo_building() -> Building:
    """Return the building of the demo, 20 x 15 m: a corridor in a loop, rooms around it, one spur.

    Every place of it lies within 4 m of a wall, so an URG-04LX always has something to see.
    """
    # The corridor runs around a block; x and y of its outer and inner edges.
    free: list[Rectangle] = _between((4.6, 4.2, 15.4, 10.8), (6.2, 5.8, 13.8, 9.2))
    rooms = {
        "workshop": (0.2, 0.2, 5.7, 4.0),
        "office": (5.9, 0.2, 9.8, 4.0),
        "kitchen": (10.0, 0.2, 14.6, 4.0),
        "store": (15.6, 0.2, 19.8, 5.2),
        "laboratory": (0.2, 11.0, 6.4, 14.8),
        "library": (6.6, 11.0, 12.2, 14.8),
        "lounge": (12.4, 11.0, 19.8, 14.8),
        "spur": (0.2, 6.8, 4.6, 8.4),
        "gallery": (16.0, 5.6, 19.8, 10.8),
        "core": (7.4, 6.4, 12.6, 8.6),
    }
    free += rooms.values()
    doors = [
        (7.0, 4.0, 8.0, 4.2),  # office
        (11.8, 4.0, 12.8, 4.2),  # kitchen
        (4.6, 4.0, 5.6, 4.2),  # workshop
        (4.7, 10.8, 5.7, 11.0),  # laboratory
        (8.8, 10.8, 9.8, 11.0),  # library
        (13.4, 10.8, 14.4, 11.0),  # lounge
        (15.4, 7.4, 16.0, 8.4),  # gallery
        (17.4, 5.2, 18.4, 5.6),  # from the gallery into the store
        (17.6, 10.8, 18.6, 11.0),  # from the gallery into the lounge
        (9.4, 5.8, 10.4, 6.4),  # core
    ]
    free += doors
    # Closed doors and niches in the corridor.
    free += [(5.6, 10.8, 6.4, 10.8 + RECESS_M), (15.4, 5.0, 15.4 + RECESS_M, 5.9), (13.0, 9.0, 13.6, 9.2)]
    walls = outline(free)
    furniture = [
        box(6.0, 0.4, 6.9, 1.2),  # desks of the office
        box(8.6, 0.2, 9.8, 1.0),
        box(10.0, 0.2, 10.6, 3.2),  # kitchen
        box(12.2, 1.2, 13.2, 1.9),
        box(0.6, 11.4, 2.6, 12.2),  # laboratory benches
        box(0.6, 13.6, 3.6, 14.8),
        box(6.6, 13.0, 7.0, 14.8),  # shelves of the library
        box(11.6, 11.4, 12.2, 13.6),
        box(15.2, 13.2, 16.8, 14.0),  # table of the lounge
        box(18.9, 5.6, 19.8, 7.0),  # gallery
        box(0.2, 0.2, 1.4, 2.2),  # workshop
        box(15.6, 0.2, 16.2, 4.4),  # store
        box(18.8, 0.4, 19.6, 1.4),
        box(12.6, 14.2, 13.8, 14.8),  # a dark sofa
        box(2.4, 3.5, 3.6, 4.0),  # a dark cabinet
    ]
    dark = np.repeat([False, True], [len(walls) + 4 * (len(furniture) - 2), 8])
    pillars = np.array(
        ((18.3, 9.0, 0.2), (3.9, 13.6, 0.15), (16.2, 11.8, 0.2), (9.0, 13.4, 0.15), (3.4, 1.6, 0.12))
    )
    return Building(np.vstack((walls, *furniture)), pillars, dark, DEMO_ROUTE, closed=True, name="demo")


DEMO_ROUTE: Array = np.array(
    (
        (6.0, 5.0), (7.5, 5.0), (7.5, 2.4), (7.5, 5.0), (9.9, 5.0), (9.9, 7.5), (9.9, 5.0), (12.3, 5.0),
        (12.3, 3.0), (11.4, 2.2), (12.3, 3.0), (12.3, 5.0), (14.6, 5.0), (14.6, 7.9), (16.7, 7.9),
        (17.9, 6.9), (17.9, 2.8), (17.9, 6.9), (16.9, 8.2), (17.0, 10.0), (18.1, 10.4), (18.1, 12.6),
        (14.6, 12.6), (13.9, 12.2), (13.9, 10.0), (9.3, 10.0), (9.3, 12.2), (10.4, 12.8), (9.3, 12.2),
        (9.3, 10.0), (5.2, 10.0), (5.2, 12.6), (3.0, 12.8), (5.2, 12.6), (5.2, 10.0), (5.4, 9.2),
        (5.4, 7.6), (1.6, 7.6),
        (5.4, 7.6), (5.4, 5.4), (5.1, 4.8), (5.1, 2.6), (2.6, 2.6), (5.1, 2.6), (5.1, 4.8),
    )
)  # fmt: skip


def _between(outer: Rectangle, inner: Rectangle) -> list[Rectangle]:
    """Return the four bands of floor between two rectangles."""
    (x0, y0, x1, y1), (u0, v0, u1, v1) = outer, inner
    return [(x0, y0, x1, v0), (x0, v1, x1, y1), (x0, v0, u0, v1), (u1, v0, x1, v1)]


def _ring(side_m: float, width_m: float) -> list[Rectangle]:
    outer = side_m + width_m
    return _between((0.0, 0.0, outer, outer), (width_m, width_m, side_m, side_m))


def _ring_route(side_m: float, width_m: float) -> Array:
    low, high = width_m / 2, side_m + width_m / 2
    middle = (low + high) / 2
    return np.array(((middle, low), (high, low), (high, high), (low, high), (low, low)))
