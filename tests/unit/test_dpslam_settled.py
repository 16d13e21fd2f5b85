"""The settled map grows into what it would be if built at once, and holds scans that lie on it."""

import numpy as np
import pytest

from processing.dpslam.settled import CELL_M, FLAT, SettledMap
from processing.dpslam.settled_kernels import FLAT_RATIO, ONE_SIDED
from processing.local_map import BEHIND_M, BEHIND_SLANT
from processing.ndt import NdtConfig
from processing.se2 import between, invert, transform
from tests.unit import naive_odometry as naive

CONFIG = NdtConfig(cell_m=CELL_M, flat_ratio=FLAT)
HERE = np.zeros(3)
"""Where the laser is taken to have been."""


def room(seed=0, count=4000):
    """Noisy points of the walls of a room of 6 by 4 m with a pillar."""
    rng = np.random.default_rng(seed)
    u = rng.uniform(0, 1, count)
    side = rng.integers(0, 5, count)
    x = np.choose(side, (6 * u, 6 * u, 0 * u, 6 + 0 * u, 4 + 0.3 * np.cos(6.28 * u)))
    y = np.choose(side, (0 * u, 4 + 0 * u, 4 * u, 4 * u, 2 + 0.3 * np.sin(6.28 * u)))
    return np.column_stack((x, y)) + rng.normal(0, 0.01, (count, 2))


def test_it_makes_no_difference_in_which_pieces_the_points_came():
    points = room() - (3.0, 2.0)
    whole, pieces = SettledMap(), SettledMap()
    whole.add(points, HERE)
    # From the middle outwards, so that the window has to grow on all sides.
    for part in np.array_split(points[np.argsort(np.abs(points).max(axis=1))], 37):
        pieces.add(part, HERE)
    probe = np.random.default_rng(1).uniform(-3.5, 3.5, (500, 2))
    nowhere = np.zeros(3)
    np.testing.assert_allclose(pieces.fits(probe, nowhere), whole.fits(probe, nowhere), atol=1e-6)


@pytest.mark.parametrize("at_once", [True, False])
def test_the_fit_of_each_point_is_that_of_four_plain_grids(at_once):
    points = room(count=1500) - (3.0, 2.0)
    settled = SettledMap()
    if at_once:
        settled.add(points + 50.0, HERE)
        settled.rebuild([points], HERE[None])
    else:
        for part in np.array_split(points[np.argsort(np.abs(points).max(axis=1))], 5):
            settled.add(part, HERE)
    plain = naive.Ndt(points, CONFIG)
    rng = np.random.default_rng(2)
    probe = np.vstack((points[::8] + rng.normal(0.0, 0.03, (188, 2)), rng.uniform(-4.0, 4.0, (150, 2))))
    pose = np.array((0.3, -0.2, 0.5))
    found = settled.fits(np.ascontiguousarray(transform(invert(pose), probe)), pose)
    expected = [plain.point_score(point) if plain.knows(point) else -1.0 for point in probe]
    assert (found < 0.0).sum() > 40
    assert (found > 0.3).sum() > 60
    np.testing.assert_allclose(found, expected, atol=1e-9)


def test_a_scan_finds_its_place():
    settled = SettledMap()
    settled.add(room(), HERE)
    truth = np.array((2.0, 1.5, 0.4))
    scan = transform(invert(truth), room(seed=5, count=200))
    guess = truth + np.array((0.12, -0.1, 0.04))
    fit = settled.refine(scan, guess, np.diag((1.0, 1.0, 1.0)))
    assert np.abs(between(truth, fit.map_t_points)).max() < 0.01
    assert np.linalg.eigvalsh(fit.information).min() > 0.0
    assert (settled.fits(scan, fit.map_t_points) > 0.3).mean() > 0.7


def test_ground_that_was_never_seen_is_unknown():
    settled = SettledMap()
    assert (settled.fits(room(), np.zeros(3)) == -1.0).all()
    settled.add(room(), HERE)
    far = np.array((100.0, 100.0, 0.0))
    assert (settled.fits(room(), far) == -1.0).all()
    settled.clear()
    assert (settled.fits(room(), np.zeros(3)) == -1.0).all()


def test_a_wall_holds_across_itself_only():
    rng = np.random.default_rng(3)
    wall = np.column_stack((rng.uniform(0, 10, 3000), rng.normal(0, 0.01, 3000)))
    settled = SettledMap()
    settled.add(wall, HERE)
    part = wall[(wall[:, 0] > 4) & (wall[:, 0] < 6)][::6] - (5.0, 0.0)
    fit = settled.refine(part, np.array((5.0 + 0.3 * CELL_M, 0.03, 0.0)), np.diag((1.0, 1.0, 1.0)))
    assert abs(fit.map_t_points[1]) < 0.005
    # Nothing holds it along the wall but a prior of a metre.
    assert abs(fit.map_t_points[0] - (5.0 + 0.3 * CELL_M)) < 0.06
    assert fit.information[0, 0] < 1e-2 * fit.information[1, 1]


def test_built_anew_it_takes_the_room_of_its_area_and_not_that_of_its_points():
    points = room() - (3.0, 2.0)
    once, often = SettledMap(), SettledMap()
    once.rebuild([points], HERE[None])
    often.rebuild([points] * 25, np.tile(HERE, (25, 1)))
    sizes = [sum(part.nbytes for part in settled.state().values()) for settled in (once, often)]
    assert sizes[1] < 2 * sizes[0]
    probe = np.random.default_rng(1).uniform(-3.5, 3.5, (500, 2))
    known = once.fits(probe, np.zeros(3)) >= 0.0
    assert known.sum() > 50
    assert (often.fits(probe, np.zeros(3)) >= 0.0)[known].all()


def wall(seed=0, x_m=2.0, count=400):
    """Points of a wall at x, two metres long."""
    rng = np.random.default_rng(seed)
    return np.column_stack((x_m + rng.normal(0, 0.01, count), rng.uniform(-1.0, 1.0, count)))


def seen_from(settled, points, *places):
    """Let a laser see the points from each place."""
    for place in places:
        pose = np.array((*place, 0.3))
        settled.add(np.ascontiguousarray(transform(invert(pose), points)), pose)


def share_away(settled, points, place):
    """How many of the points face away from a laser at a place."""
    pose = np.array((*place, -0.4))
    return settled.away(np.ascontiguousarray(transform(invert(pose), points)), pose).mean()


def test_a_wall_seen_from_one_side_faces_away_from_the_other():
    settled = SettledMap()
    seen_from(settled, wall(), (0.0, 0.0), (0.5, -1.5))
    for before in ((1.0, 0.0), (0.0, 3.0), (1.9, 0.5), (2.04, 0.0)):
        assert share_away(settled, wall(1), before) == 0.0
    for behind in ((3.0, 0.0), (4.0, 2.0), (2.4, -0.5)):
        assert share_away(settled, wall(1), behind) > 0.9
    # The neighbour's wall, where it is not known itself, lies on this one's cells.
    assert share_away(settled, wall(1, x_m=2.1), (3.0, 0.0)) > 0.9
    # Where nothing is known nothing faces away.
    assert share_away(settled, wall(1, x_m=3.0), (4.0, 0.0)) == 0.0


def test_a_wall_seen_from_both_sides_or_along_itself_faces_everywhere():
    both, along = SettledMap(), SettledMap()
    seen_from(both, wall(), (0.0, 0.0), (4.0, 0.0))
    seen_from(along, wall(), (2.0, -6.0))
    for settled in (both, along):
        for place in ((1.0, 0.0), (3.0, 0.0), (2.0, 9.0)):
            assert share_away(settled, wall(1), place) == 0.0


def test_the_views_are_taken_along_by_a_growing_window_and_by_what_is_kept():
    settled, again = SettledMap(), SettledMap()
    seen_from(settled, wall(), (0.0, 0.0))
    seen_from(settled, transform(np.array((-30.0, 20.0, 0.0)), wall()), (-30.0, 20.0))
    again.restore(settled.state())
    for one in (settled, again):
        assert share_away(one, wall(1), (3.0, 0.0)) > 0.9
        assert share_away(one, wall(1), (1.0, 0.0)) == 0.0


def test_what_faces_away_is_what_a_plain_look_at_the_points_says():
    rng = np.random.default_rng(5)
    scans = [np.ascontiguousarray(room(seed=k, count=300)) for k in range(6)]
    path = np.column_stack((rng.uniform(-2.0, 8.0, (6, 2)), rng.uniform(-3.0, 3.0, 6)))
    local = [np.ascontiguousarray(transform(invert(at), scan)) for at, scan in zip(path, scans, strict=True)]
    settled = SettledMap()
    settled.rebuild(local, path)
    pose = np.array((7.0, 2.0, 0.7))
    probe = np.vstack((scans[0][::3] + rng.normal(0.0, 0.05, (100, 2)), rng.uniform(-1.0, 7.0, (60, 2))))
    found = settled.away(np.ascontiguousarray(transform(invert(pose), probe)), pose)
    seen = [(point, at[:2]) for scan, at in zip(scans, path, strict=True) for point in scan]
    expected = [plainly_away(point, seen, pose[:2]) for point in probe]
    assert 20 < sum(expected) < 100
    np.testing.assert_array_equal(found, expected)


def plainly_away(point, seen, laser):
    """Whether each of the four blocks around a point that is known faces away, and there is one."""
    half_m = 0.5 * CELL_M
    known = []
    for row, col in ((-1, -1), (-1, 0), (0, -1), (0, 0)):
        corner = (np.floor(point / half_m) + np.array((col, row))) * half_m
        inside = [(p, at) for p, at in seen if ((p >= corner) & (p < corner + CELL_M)).all()]
        if len(inside) < CONFIG.min_points:
            continue
        mean, covariance = naive.Ndt([], CONFIG)._normal(np.array([p for p, _ in inside]))
        (small, large), vectors = np.linalg.eigh(covariance)
        normal = vectors[:, 0]
        views = sum((at - p) / np.hypot(*(at - p)) for p, at in inside)
        side, off = normal @ views, laser - mean
        beyond = -np.sign(side) * (normal @ off) - BEHIND_M
        known.append(
            small <= FLAT_RATIO * large
            and abs(side) >= ONE_SIDED * len(inside)
            and beyond > max(0.0, BEHIND_SLANT * np.hypot(*off))
        )
    return bool(known) and all(known)


def test_each_place_is_owned_by_the_scan_that_saw_it_first():
    first, second = room(), room() + np.array((20.0, 0.0))
    settled = SettledMap()
    settled.add(first, HERE)
    settled.add(np.zeros((0, 2)), HERE)
    settled.add(np.vstack((first, second)), HERE)
    nowhere = np.array(((10.0, 0.0), (500.0, 0.0), (-500.0, 3.0)))
    for one, built in ((settled, False), (SettledMap(), True)):
        if built:
            one.rebuild([first, np.zeros((0, 2)), np.vstack((first, second))], np.tile(HERE, (3, 1)))
        np.testing.assert_array_equal(one.owners(first, HERE), 0)
        np.testing.assert_array_equal(one.owners(second, HERE), 2)
        assert len(one.owners(first, HERE)) == len(first)
        assert len(one.owners(nowhere, np.zeros(3))) == 0
    restored = SettledMap()
    restored.restore(settled.state())
    np.testing.assert_array_equal(restored.owners(second, HERE), 2)
