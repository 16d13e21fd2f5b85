"""The wide search finds the best place of a whole window, and says when another is as good."""

import itertools

import numpy as np
import pytest

from processing.se2 import compose, invert, transform
from processing.wide_match import LEVELS, NEAR_WALL, Window, build_field
from processing.wide_match_kernels import least_cost


def search(*window, **settings):
    return Window(*window, most=2, **settings).search()


def walls(*segments, spacing_m=0.04):
    parts = []
    for start, end in segments:
        a, b = np.array(start, float), np.array(end, float)
        steps = np.linspace(0.0, 1.0, int(np.linalg.norm(b - a) / spacing_m) + 1)[:, None]
        parts.append(a + steps * (b - a))
    return np.vstack(parts)


CORNERS = ((0, 0), (10, 0), (10, 6), (4, 6), (4, 4), (0, 4), (0, 0))
ROOM = walls(*itertools.pairwise(CORNERS), ((6, 2), (7, 3)))


UP = np.array((0.0, 12.0))
HERE = np.array((0.3, -0.2, 0.7))


def all_places(*window, **settings):
    whole = Window(*window, **settings)
    assert whole.go_on()
    return whole.places


def seen_from(pose, points, count, seed=0):
    rng = np.random.default_rng(seed)
    some = points[rng.permutation(len(points))[:count]]
    return transform(invert(pose), some) + rng.normal(0.0, 0.01, (count, 2))


@pytest.mark.parametrize("off", [(2.4, -1.9, 0.3), (-2.9, 2.2, -0.45), (0.0, 0.0, 0.0)])
def test_a_place_far_from_the_guess_is_found(off):
    truth = np.array((3.0, 2.0, 0.7))
    field = build_field(ROOM, 0.05, 0.1, 0.5)
    found = search(field, seen_from(truth, ROOM, 250), truth + off, 3.0, 0.5, 0.5)
    assert found is not None
    assert np.abs(found.best.map_t_points[:2] - truth[:2]).max() <= 0.06
    assert abs(found.best.map_t_points[2] - truth[2]) < 0.02
    assert found.rival is None or found.rival.score < 0.8 * found.best.score


def test_a_corridor_has_a_rival_along_itself():
    corridor = walls(((0, 0), (30, 0)), ((0, 2), (30, 2)))
    field = build_field(corridor, 0.05, 0.1, 0.5)
    window = corridor[(corridor[:, 0] > 13) & (corridor[:, 0] < 17)]
    truth = np.array((15.0, 1.0, 0.0))
    found = search(field, seen_from(truth, window, 150), truth, 2.0, 0.2, 0.5)
    assert found is not None
    assert found.rival is not None
    assert found.rival.score > 0.97 * found.best.score


def test_a_rival_may_be_asked_for_less_than_the_best():
    half = (ROOM + UP)[: len(ROOM) // 2]
    rooms = np.vstack((ROOM, half))
    field = build_field(rooms, 0.05, 0.1, 0.5)
    truth = np.array((3.0, 2.0, 0.7))
    window = (seen_from(truth, ROOM, 200), truth, 13.0, 0.2)
    strict = search(field, *window, 0.8)
    both = search(field, *window, 0.8, least_rival=0.3)
    assert strict is not None
    assert both is not None
    np.testing.assert_array_equal(strict.best.map_t_points, both.best.map_t_points)
    assert strict.rival is None
    assert both.rival is not None
    assert 0.3 <= both.rival.score < 0.8
    assert search(field, *window, 0.999, least_rival=0.3) is None


COSTS = np.array(((0.5, 0.2, -0.1), (0.2, 0.3, 0.1), (-0.1, 0.1, 2.0)))


@pytest.mark.parametrize("costs", [None, COSTS])
@pytest.mark.parametrize("passed", [False, True])
def test_the_best_of_the_window_equals_the_best_of_every_cell(costs, passed):
    rng = np.random.default_rng(4)
    squares = np.floor(rng.uniform(-0.4, 4.4, (200, 2)) / 0.2) * 0.2 + 0.1
    field = build_field(rng.uniform(0, 4, (60, 2)), 0.1, 0.15, 0.3, *((squares, 0.2) if passed else ()))
    points = rng.uniform(-1.5, 1.5, (40, 2))
    guess = np.array((2.0, 2.0, 0.4))
    found = search(field, points, guess, 1.0, 0.3, 0.0, costs=costs)
    turn = 0.1 / max(float(np.linalg.norm(points, axis=1).max()), 1.0)
    best = 0.0
    for k in range(-int(np.ceil(0.3 / turn)), int(np.ceil(0.3 / turn)) + 1):
        moved = transform(np.array((guess[0], guess[1], guess[2] + k * turn)), points)
        cells = np.floor((moved - field.origin_m) / 0.1).astype(int)
        for row in range(-10, 11):
            for col in range(-10, 11):
                at = cells + np.array((col, row))
                inside = (at >= 0).all(axis=1) & (at < field.levels.shape[:0:-1]).all(axis=1)
                off = np.array((0.1 * col, 0.1 * row, k * turn))
                cost = 0.0 if costs is None else off @ costs @ off
                best = max(best, field.levels[0][at[inside, 1], at[inside, 0]].sum() / len(points) - cost)
    assert found is not None
    assert found.best.score == pytest.approx(best, abs=1e-6)


def test_every_level_bounds_the_cells_under_it():
    field = build_field(ROOM, 0.1, 0.1, 0.5)
    for level in range(1, LEVELS):
        side = 2**level
        row, col = 12, 31
        window = field.levels[0][row : row + side, col : col + side]
        assert field.levels[level][row, col] == window.max()


@pytest.mark.parametrize("level", range(LEVELS))
def test_no_cell_of_a_square_costs_less_than_the_square(level):
    side, least = 2**level, []
    for col, row in ((-40, 3), (-side // 2, -side // 2), (0, 0), (6 * side, -8 * side)):
        offsets = [(0.1 * (col + i), 0.1 * (row + j), 0.2) for i in range(side) for j in range(side)]
        cheapest = min(np.array(off) @ COSTS @ np.array(off) for off in offsets)
        least.append((least_cost(COSTS, col, row, 0.2, level, 0.1), cheapest))
    below, cheapest = np.array(least).T
    assert (below <= cheapest + 1e-12).all()
    # A bound of nothing would be one, too.
    assert below.max() > 0.5 * cheapest[below.argmax()]
    if level == 0:
        np.testing.assert_allclose(below, cheapest)


def test_rays_lower_what_they_passed_but_no_wall():
    wall = walls(((0.0, 0.0), (3.0, 0.0)))
    squares = np.array([(x, y) for x in np.arange(0.1, 3.0, 0.2) for y in (-0.9, 0.1, 0.9)])
    plain, field = (build_field(wall, 0.1, 0.1, 1.0, *passed) for passed in ((), (squares, 0.2)))
    lowered = np.zeros(field.levels[0].shape, bool)
    rows, cols = lowered.shape
    for row in range(1, rows - 1):
        for col in range(1, cols - 1):
            middle = field.origin_m + (np.array((col, row)) + 0.5) * 0.1
            passed = (np.abs(squares - middle) < 0.1).all(axis=1).any()
            lowered[row, col] = passed and plain.levels[0][row, col] <= NEAR_WALL
    assert lowered.sum() > 50
    np.testing.assert_array_equal(field.levels[0], np.where(lowered, np.float32(-1.0), plain.levels[0]))
    there = np.array(((0.55, 0.01), (0.55, 0.95), (0.55, 0.55), (50.0, 0.0)))
    fits = field.at(transform(invert(HERE), there), HERE)
    assert fits[0] > 0.8
    np.testing.assert_array_equal(fits[1:], (-1.0, 0.0, 0.0))


def test_of_two_places_as_good_the_likelier_is_the_best():
    there, elsewhere = np.array((1.0, 0.0, 0.0)), np.array((-1.0, 0.0, 0.0))
    comb = walls(*(((x, -2.0), (x, 2.0)) for x in (-3.0, -1.0, 1.0, 3.0)), ((-3.0, 0.0), (3.0, 0.0)))
    part = walls(((0.0, -1.0), (0.0, 1.0)), ((-0.5, 0.0), (0.5, 0.0)))
    field = build_field(comb, 0.05, 0.08, 0.5)
    for likely, other in ((there, elsewhere), (elsewhere, there)):
        off = np.array((0.3 * np.sign(likely[0]), 0.0, 0.0))
        found = search(field, part, off, 1.5, 0.2, 0.3, costs=np.diag((0.1, 0.1, 1.0)))
        assert found is not None
        assert np.abs(found.best.map_t_points - likely).max() < 0.06
        assert np.abs(found.rival.map_t_points - other).max() < 0.06
        assert found.best.score - found.rival.score == pytest.approx(0.1 * (1.3**2 - 0.7**2), abs=0.05)


def test_nothing_is_found_where_nothing_fits():
    field = build_field(ROOM, 0.05, 0.1, 0.5)
    cloud = np.random.default_rng(2).uniform(-3, 3, (200, 2))
    assert search(field, cloud, np.array((5.0, 3.0, 0.0)), 1.0, 0.3, 0.6) is None


def test_a_map_without_points_is_refused():
    with pytest.raises(ValueError, match="0 points"):
        build_field(np.empty((0, 2)), 0.05, 0.1, 0.5)


def test_the_answer_moves_with_the_map():
    truth, shift = np.array((3.0, 2.0, 0.7)), np.array((-8.0, 4.0, 0.0))
    points = seen_from(truth, ROOM, 250)
    here = search(build_field(ROOM, 0.05, 0.1, 0.5), points, truth, 1.0, 0.2, 0.5)
    there = search(
        build_field(transform(shift, ROOM), 0.05, 0.1, 0.5), points, compose(shift, truth), 1.0, 0.2, 0.5
    )
    assert here is not None
    assert there is not None
    np.testing.assert_allclose(compose(shift, here.best.map_t_points), there.best.map_t_points, atol=0.051)


def test_three_rooms_alike_are_three_places_and_a_fourth_is_none():
    rooms = np.vstack([ROOM + number * UP for number in range(3)])
    field = build_field(rooms, 0.1, 0.12, 0.5)
    seen = seen_from(np.array((3.0, 14.0, 0.7)), ROOM + UP, 200)
    middle = np.array((5.0, 15.0, 0.0))
    places = all_places(field, seen, middle, 16.0, np.pi, 0.5, 1.0, 0.5, least_share=0.9)
    assert sorted(round(place.map_t_points[1]) for place in places) == [2, 14, 26]
    assert all(np.abs(place.map_t_points[[0, 2]] - (3.0, 0.7)).max() < 0.15 for place in places)


def test_where_there_is_no_ground_no_place_is_looked_for():
    rooms = np.vstack((ROOM, ROOM + UP))
    field = build_field(rooms, 0.1, 0.12, 0.5)
    seen = seen_from(np.array((3.0, 2.0, 0.7)), ROOM, 200)
    ground = np.array(np.meshgrid(np.arange(0.5, 10.0, 0.3), np.arange(12.5, 16.0, 0.3))).reshape(2, -1).T
    middle = np.array((5.0, 9.0, 0.0))
    everywhere = all_places(field, seen, middle, 10.0, np.pi, 0.5, 1.0, 0.5, least_share=0.9)
    (place,) = all_places(field, seen, middle, 10.0, np.pi, 0.5, 1.0, 0.5, least_share=0.9, ground=ground)
    assert len(everywhere) == 2
    assert place.map_t_points[1] == pytest.approx(14.0, abs=0.15)


@pytest.mark.parametrize("squares", [1, 300, 20_000])
def test_a_search_left_off_and_gone_on_with_finds_the_same(squares):
    rooms = np.vstack([ROOM + number * UP for number in range(3)])
    field = build_field(rooms, 0.1, 0.12, 0.5)
    window = (field, seen_from(np.array((3.0, 14.0, 0.7)), ROOM + UP, 60), np.array((5.0, 15.0, 0.0)))
    bounds = (16.0, 1.0, 0.5, 1.0, 0.5)
    whole = all_places(*window, *bounds, least_share=0.9)
    search, rounds = Window(*window, *bounds, least_share=0.9), 1
    while not search.go_on(squares):
        rounds += 1
        written = search.state()
        search = Window(*window, *bounds, least_share=0.9)
        search.restore(written)
    assert rounds > (3 if squares < 20_000 else 0)
    assert len(whole) == 3
    for one, other in zip(whole, search.places, strict=True):
        np.testing.assert_array_equal(one.map_t_points, other.map_t_points)
        assert one.score == other.score
