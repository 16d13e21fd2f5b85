"""A room that is the same turned by half a circle has two places for a scan, and both are reported."""

import numpy as np
import pytest

from processing.se2 import between, invert, transform
from processing.wide_match import Window, build_field

TURN = np.array((0.0, 0.0, np.pi))


def search(*window, **settings):
    return Window(*window, most=2, **settings).search()


def room(width_m, depth_m, spacing_m=0.04):
    x, y = (np.arange(-half, half, spacing_m) for half in (width_m / 2, depth_m / 2))
    walls = [np.column_stack((x, np.full(len(x), side * depth_m / 2))) for side in (1.0, -1.0)]
    walls += [np.column_stack((np.full(len(y), side * width_m / 2), y)) for side in (1.0, -1.0)]
    return np.concatenate(walls)


def looked_for(points_map, truth):
    field = build_field(points_map, 0.05, 0.08, 0.5)
    points = transform(invert(truth), points_map[::3])
    return search(field, points, np.zeros(3), 1.5, np.pi, 0.5)


@pytest.mark.parametrize("truth", [(0.4, -0.3, 0.2), (-0.6, 0.5, 1.1)])
def test_the_two_places_of_an_even_room_are_found_and_are_as_good(truth):
    truth = np.array(truth)
    found = looked_for(room(5.0, 3.6), truth)
    assert found is not None
    assert found.rival is not None
    assert found.rival.score > 0.97 * found.best.score
    # Where it is, and where it would be after half a turn of the room.
    turned = np.append(transform(TURN, truth[None, :2])[0], truth[2] + np.pi)
    for place in (truth, turned):
        off = [between(place, found_place.map_t_points) for found_place in (found.best, found.rival)]
        assert min(np.hypot(o[0], o[1]) + abs(o[2]) for o in off) < 0.15


def test_one_niche_tells_the_two_places_apart():
    truth = np.array((0.4, -0.3, 0.2))
    niche = np.column_stack((np.arange(0.6, 2.0, 0.02), np.full(70, 1.2)))
    found = looked_for(np.concatenate((room(5.0, 3.6), niche)), truth)
    assert found is not None
    off = between(truth, found.best.map_t_points)
    assert np.hypot(off[0], off[1]) + abs(off[2]) < 0.15
    assert found.rival is None or found.rival.score < 0.95 * found.best.score
