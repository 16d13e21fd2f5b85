"""The map as probabilities: what is known, what is not, and how it looks to others."""

import numpy as np
import pytest

from processing.occupancy import OccupancyGrid, occupancy_of


def grid_of(values):
    return OccupancyGrid(np.array(values, dtype=np.float32), 0.05, (0.0, 0.0))


def test_unknown_is_kept_apart_from_half_probable():
    grid = grid_of([[0.5, np.nan]])
    assert grid.percent().tolist() == [[50, -1]]
    assert grid.percent().dtype == np.int8
    assert grid.trinary().tolist() == [[205, 205]]


def test_three_values_of_the_picture_follow_the_usual_thresholds():
    assert grid_of([[0.9, 0.651, 0.649, 0.251, 0.249, 0.0]]).trinary().tolist() == [
        [0, 0, 205, 205, 254, 254]
    ]


def test_a_cell_is_as_probable_as_a_ray_stops_in_it():
    stops, metres = np.array([[10.0, 0.0, 1.0, 0.0]]), np.array([[0.25, 2.0, 0.0, 0.0]])
    grid = occupancy_of(stops, metres, 0.05, (0.0, 0.0))
    wall, free, once = grid.probability[0]
    assert wall == pytest.approx(1 - np.exp(-(10 + 0.00625) / 0.30 * 0.05))
    assert free < 0.01
    assert 0.5 < once < 0.65  # one stop is a rumour
    assert grid.probability.shape == (1, 3)


def test_a_cell_that_a_ray_only_brushed_is_unknown():
    grid = occupancy_of(np.array([[5.0, 0.0]]), np.array([[0.1, 0.001]]), 0.05, (0.0, 0.0))
    assert grid.probability.shape == (1, 1)


def test_the_unseen_border_is_left_away_and_the_corner_moves_with_it():
    stops, metres = np.zeros((6, 8)), np.zeros((6, 8))
    metres[2:4, 3:7] = 0.5
    grid = occupancy_of(stops, metres, 0.05, (-1.0, 2.0))
    assert grid.probability.shape == (2, 4)
    assert grid.origin_m == pytest.approx((-1.0 + 0.15, 2.0 + 0.1))
    assert not np.isnan(grid.probability).any()


def test_nothing_seen_is_one_unknown_cell():
    grid = occupancy_of(np.zeros((4, 4)), np.zeros((4, 4)), 0.05, (0.0, 0.0))
    assert np.isnan(grid.probability).all()
    assert grid.probability.shape == (1, 1)


@pytest.mark.parametrize(("shape", "resolution"), [((3,), 0.05), ((2, 2), 0.0), ((2, 2), float("nan"))])
def test_a_grid_that_is_none_is_refused(shape, resolution):
    with pytest.raises(ValueError, match=r"must be"):
        OccupancyGrid(np.zeros(shape, dtype=np.float32), resolution, (0.0, 0.0))
