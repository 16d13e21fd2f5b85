"""The laser model against rays computed by hand, cell by cell."""

import itertools

import numpy as np
import pytest

from processing.dpslam import kernels
from processing.dpslam.grid import CELL_M, METRES, STOPS, TileStore
from processing.dpslam.laser_model import (
    FLOOR,
    NEAR_M,
    PRIOR_DENSITY,
    PRIOR_M,
    SIGMA_M,
    score_rays,
    stop_probability,
)
from processing.dpslam.writing import write_rays

HERE = np.zeros((1, 3))


def write(rays, memory=100.0):
    store = TileStore(1)
    store.cover(np.array((-8.0, -8.0)), np.array((8.0, 8.0)))
    store.reserve(200)
    e = store.extent
    touched = np.empty(10_000, dtype=np.int32)
    write_rays(store.arrays, store.table, 0, e.first_row, e.first_col, np.array(rays), memory, touched)
    return store


def score(store, rays, whole=True, unseen=0.0):
    e = store.extent
    place = (store.arrays, store.table, 0, e.first_row, e.first_col)
    return score_rays(*place, np.array(rays), 0, 1, whole, unseen)


def cells_of(store):
    cells, (row, col) = store.dense(0)
    return {
        (int(r) + row, int(c) + col): (cells[r, c, 0] / STOPS, cells[r, c, 1] / METRES)
        for r, c in np.argwhere(cells[..., :2].any(axis=2))
    }


def test_a_ray_along_an_axis_leaves_its_metres_in_each_cell_and_a_stop_in_the_last():
    cells = cells_of(write([(0.01, 0.02, 0.22, 0.02)]))
    # 4 cm of the first cell, three whole cells, 2 cm of the last.
    for col, metres in enumerate((0.04, 0.05, 0.05, 0.05, 0.02)):
        stops, travelled = cells.pop((0, col))
        assert travelled == pytest.approx(metres, abs=1 / METRES)
        assert stops == (1.0 if col == 4 else 0.0)
    assert cells == {}


def test_a_slanted_ray_leaves_the_chord_of_each_cell_that_it_crosses():
    # From the middle of cell (0, 0), slope 3/4: leaves it at x = 0.05, y = 0.04375, and so on.
    cells = cells_of(write([(0.025, 0.025, 0.105, 0.085)]))
    chord = 5 / 4  # length for each metre of x
    expected = {
        (0, 0): 0.025 * chord,  # to x = 0.05
        (0, 1): (0.0583333 - 0.05) * chord,  # to y = 0.05
        (1, 1): (0.1 - 0.0583333) * chord,
        (1, 2): 0.005 * chord,
    }
    assert set(cells) == set(expected)
    for place, metres in expected.items():
        assert cells[place][1] == pytest.approx(metres, abs=1 / METRES)
    assert cells[1, 2][0] == 1.0


@pytest.mark.parametrize("angle", np.linspace(0.0, 2.0 * np.pi, 17))
def test_the_metres_of_a_ray_sum_up_to_its_length_in_every_direction(angle):
    x, y = 0.0123, -0.0077
    cells = cells_of(write([(x, y, x + 3.3 * np.cos(angle), y + 3.3 * np.sin(angle))]))
    assert sum(metres for _, metres in cells.values()) == pytest.approx(3.3, abs=len(cells) / METRES)
    assert sum(stops for stops, _ in cells.values()) == 1.0


def test_a_cell_keeps_the_mean_of_its_end_points():
    store = write([(0.0, 0.0, 1.01, 0.002), (0.0, 0.0, 1.03, 0.012)])
    cells, (row, col) = store.dense(0)
    mean = cells[-row, 20 - col, 2:] / 65536 * CELL_M
    assert mean == pytest.approx((0.02, 0.007), abs=1e-5)


def test_density_is_stops_for_each_metre_with_a_prior():
    # One stop, 2 cm of travel: (1 + 1/8 * 0.05) / (0.02 + 0.05) stops a metre, over a stretch of 5 cm.
    density = (1 + PRIOR_DENSITY * PRIOR_M) / (0.02 + PRIOR_M)
    assert stop_probability(1.0, 0.02, 0.05) == pytest.approx(1 - np.exp(-density * 0.05))
    assert stop_probability(0.0, 0.0, 1.0) == pytest.approx(1 - np.exp(-PRIOR_DENSITY))


def test_a_reading_in_unseen_space_has_the_likelihood_of_the_prior_alone():
    # Nothing known: P(stop at s) = rho exp(-rho s); integrate against the bump around 1 m.
    s = np.linspace(1.0 - NEAR_M, 1.0 + NEAR_M, 200_001)
    bump = (1.0 - ((s - 1.0) / NEAR_M) ** 2) ** 8
    expected = np.trapezoid(PRIOR_DENSITY * np.exp(-PRIOR_DENSITY * s) * bump, s)
    found = score(TileStore(1), [(0.013, 0.0, 1.013, 0.0)])
    assert np.exp(found) - FLOOR == pytest.approx(expected, rel=0.02)


def test_the_bump_is_a_normal_density_without_its_ends():
    e = np.linspace(-3 * SIGMA_M, 3 * SIGMA_M, 61)
    bump = (1.0 - (e / NEAR_M) ** 2) ** 8
    assert bump == pytest.approx(np.exp(-0.5 * (e / SIGMA_M) ** 2), abs=0.04)


def by_hand(cells, start, reading, whole=True, unseen=0.0):
    """Likelihood of a ray along +x in row 0, from the model's words: cells {col: (stops, metres)}."""
    begin = start if whole else start + max(0.0, reading - NEAR_M)
    end = start + reading + NEAR_M
    edges = [begin, *(c * CELL_M for c in range(int(begin // CELL_M) + 1, int(end // CELL_M) + 1)), end]
    reached, total, frontier = 1.0, 0.0, False
    for a, b in itertools.pairwise(edges):
        stops, metres = cells.get(int((a + b) / 2 // CELL_M), (0.0, 0.0))
        stop = stop_probability(stops, metres, b - a)
        e = (a + b) / 2 - start - reading
        if abs(e) < NEAR_M:
            bump = (1.0 - (e / NEAR_M) ** 2) ** 8
            if metres == 0.0 and not frontier:
                # The first cell there that nobody has looked into: before the reading as good as at it.
                frontier = True
                total += unseen * reached * (bump if e > 0.0 else 1.0)
            total += reached * stop * bump
        reached *= 1.0 - stop
    return np.log(FLOOR + total)


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("reading", [0.7, 1.0, 1.02, 1.3])
def test_likelihoods_equal_the_sum_over_cells_computed_by_hand(reading, whole):
    # A wall at 1 m seen five times, and a thin obstacle at 0.5 m seen once.
    store = write([(0.0, 0.02, 1.0 + 0.004 * k, 0.02) for k in range(5)] + [(0.0, 0.02, 0.52, 0.02)])
    cells = {col: value for (row, col), value in cells_of(store).items() if row == 0}
    found = score(store, [(0.0, 0.02, reading, 0.02)], whole)
    assert found == pytest.approx(by_hand(cells, 0.0, reading, whole), abs=1e-9)


@pytest.mark.parametrize("whole", [True, False])
@pytest.mark.parametrize("reading", [0.7, 0.93, 1.02, 1.1, 1.3, 2.0])
def test_what_the_unseen_gives_equals_the_sum_over_cells(reading, whole):
    # Free as far as a wall at 1 m, seen thrice, and nobody has looked behind it.
    store = write([(0.0, 0.02, 1.0 + 0.004 * k, 0.02) for k in range(3)])
    cells = {col: value for (row, col), value in cells_of(store).items() if row == 0}
    ray = [(0.0, 0.02, reading, 0.02)]
    found = score(store, ray, whole, unseen=0.4)
    assert found == pytest.approx(by_hand(cells, 0.0, reading, whole, 0.4), abs=1e-9)
    gained = np.exp(score(store, ray, whole, unseen=0.4)) - np.exp(score(store, ray, whole))
    # Where the ray is read before all that is unseen there is nothing to gain; elsewhere there is.
    assert (gained > 1e-4) == (reading > 0.8)


def test_a_ray_through_a_wall_is_less_likely_than_one_that_stops_at_it():
    store = write([(0.0, 0.02, 1.0, 0.02)] * 10)
    at_wall, short, behind = (score(store, [(0.0, 0.02, r, 0.02)]) for r in (1.01, 0.5, 1.8))
    assert at_wall > short + 3.0
    assert at_wall > behind + 3.0


def test_the_cheap_score_looks_only_around_the_reading():
    blocked = write([(0.0, 0.02, 1.02, 0.02)] * 10 + [(0.0, 0.02, 0.42, 0.02)] * 30)
    ray = [(0.0, 0.02, 1.02, 0.02)]
    assert score(blocked, ray, whole=False) > score(blocked, ray, whole=True) + 0.5


def test_what_has_moved_away_fades():
    memory = 60.0
    person = [(0.0, 0.02, 1.02, 0.02)] * 8
    gone = [(0.0, 0.02, 2.0, 0.02)] * 60
    stayed = cells_of(write(person, memory))[0, 20]
    left = cells_of(write(person + gone, memory))[0, 20]
    assert stop_probability(*stayed, CELL_M) > 0.65
    assert stop_probability(*left, CELL_M) < 0.25
    # And a wall that was seen for long goes too, if more slowly.
    wall = cells_of(write([(0.0, 0.02, 1.02, 0.02)] * 500 + gone * 3, memory))[0, 20]
    assert stop_probability(*wall, CELL_M) < 0.25


def test_no_cell_remembers_more_than_its_memory():
    cells = cells_of(write([(0.0, 0.02, 1.02, 0.02)] * 500, 60.0))
    for stops, metres in cells.values():
        assert stops + metres / CELL_M <= 60.0 + 1e-6


def test_blocks_hold_the_moments_of_their_occupied_cells():
    rng = np.random.default_rng(4)
    ends = rng.uniform((1.0, -0.4), (1.3, 0.4), (300, 2))
    store = write(np.column_stack((np.zeros((300, 2)), ends)))
    e, table = store.extent, store.table[0]
    checked = 0
    for row, col in np.argwhere(table >= 0):
        tile = table[row, col]
        cells = store.arrays[0][tile].reshape(32, 32, 2) / (STOPS, METRES)
        means = store.arrays[1][tile].reshape(32, 32, 2) / 65536
        blocks = store.arrays[2][tile].reshape(8, 8, 6)
        for r in range(8):
            for c in range(8):
                moments = np.zeros(6)
                for i, j in np.ndindex(4, 4):
                    at = 4 * r + i, 4 * c + j
                    if cells[at][0] > 0 and stop_probability(*cells[at], CELL_M) >= 0.25:
                        w = min(cells[at][0], 10.0)
                        x, y = (np.array((j, i)) + means[at]) * CELL_M
                        moments += w * np.array((1.0, x, y, x * x, x * y, y * y))
                        checked += 1
                assert blocks[r, c] == pytest.approx(moments, rel=1e-5, abs=1e-6)
    assert checked > 40
    assert e.rows * e.cols == table.size


def test_key_scans_written_at_once_are_those_written_one_by_one():
    rng = np.random.default_rng(1)
    scans = [np.column_stack((np.zeros((40, 2)), rng.normal(0, 2, (40, 2)))) for _ in range(5)]
    path = rng.normal(0, 1, (5, 3))
    rays = np.concatenate(scans)
    ends = np.arange(6, dtype=np.int64) * 40
    one, many = TileStore(1), TileStore(1)
    low, high, tiles = kernels.bounds(rays, ends, path)
    for store in (one, many):
        store.cover(low, high)
        store.reserve(5 * tiles)
    for k in range(5):
        own = rays[ends[k] : ends[k + 1]]
        kernels.write_all(*one.maps, own, path[k : k + 1].copy(), 60.0, 0)
    kernels.write_path(*many.maps, rays, ends, path, 60.0, 0)
    assert np.array_equal(one.dense(0)[0], many.dense(0)[0])


def test_a_ray_into_the_unseen_gains_what_is_given_for_it():
    store = write([(0.0, 0.02, 1.02, 0.02)] * 30)
    beyond = [(0.0, 0.02, 0.02, 2.0)]
    plain = np.exp(score(store, beyond))
    # Nothing is known all the way: the ray comes through the prior density to where it was read.
    through = np.exp(-PRIOR_DENSITY * (2.0 - NEAR_M))
    assert np.exp(score(store, beyond, unseen=0.5)) == pytest.approx(plain + 0.5 * through, rel=0.05)
    # One that ends on a wall gains nothing but what comes through the wall.
    wall = [(0.0, 0.02, 1.02, 0.02)]
    assert score(store, wall, unseen=0.5) == pytest.approx(score(store, wall), abs=0.05)
