"""A pose for every scan: key scans where the map has them, the others between by the odometry."""

import numpy as np
import pytest

from processing import se2
from processing.dpslam.trail import Trail


def trail_of(odom, keys):
    trail = Trail()
    for number, pose in enumerate(odom):
        trail.add(100 - number, pose)  # stamps may go backwards; order is that of arrival
        if number in keys:
            trail.mark_key()
    return trail


ODOM = np.array([(0.1 * k, 0.02 * k * k, 0.05 * k) for k in range(9)])


def test_without_corrections_the_path_is_the_odometry():
    trail = trail_of(ODOM, {0, 4, 7})
    assert trail.lay(ODOM[[0, 4, 7]]) == pytest.approx(ODOM, abs=1e-12)
    assert trail.stamps_ns.tolist() == list(range(100, 91, -1))


def test_key_scans_lie_where_the_map_has_them():
    map_t_keys = np.array(((0.0, 0.0, 0.0), (0.5, 0.1, 0.3), (0.7, 0.9, 0.2)))
    laid = trail_of(ODOM, {0, 4, 7}).lay(map_t_keys)
    assert laid[[0, 4, 7]] == pytest.approx(map_t_keys, abs=1e-12)


def test_between_key_scans_what_the_odometry_misses_is_spread_evenly():
    odom = np.array([(0.1 * k, 0.0, 0.0) for k in range(5)])
    laid = trail_of(odom, {0, 4}).lay(np.array(((0.0, 0.0, 0.0), (0.44, 0.08, 0.0))))
    assert laid[:, 0] == pytest.approx([0.0, 0.11, 0.22, 0.33, 0.44])
    assert laid[:, 1] == pytest.approx([0.0, 0.02, 0.04, 0.06, 0.08])


def test_after_the_last_key_scan_the_odometry_goes_on_alone():
    last = np.array((3.0, 1.0, np.pi / 2))
    laid = trail_of(ODOM, {0, 4}).lay(np.stack((np.zeros(3), last)))
    for k in range(5, 9):
        assert laid[k] == pytest.approx(se2.compose(last, se2.between(ODOM[4], ODOM[k])))


def test_a_turn_past_half_a_circle_is_spread_the_short_way():
    odom = np.array([(0.0, 0.0, a) for a in (3.0, 3.1, -3.1)])
    laid = trail_of(odom, {0, 2}).lay(np.array(((0.0, 0.0, 3.0), (0.0, 0.0, -3.0))))
    assert laid[1, 2] == pytest.approx(se2.wrap(3.1 + 0.05))


def test_long_runs_grow_the_trail_and_a_restored_one_goes_on():
    trail = Trail()
    for k in range(2500):
        trail.add(k, np.array((0.01 * k, 0.0, 0.0)))
        trail.mark_key()
    twin = Trail()
    twin.restore(trail.state())
    for one in (trail, twin):
        one.add(2500, np.array((99.0, 0.0, 0.0)))
        one.mark_key()
    keys = np.zeros((2501, 3))
    assert np.array_equal(trail.stamps_ns, np.arange(2501))
    assert np.array_equal(trail.lay(keys), twin.lay(keys))


def test_after_a_loss_the_way_is_known_backwards_from_where_the_laser_was_found():
    trail = Trail()
    odom = [(0.1 * k, 0.0, 0.0) for k in range(4)] + [(5.0 + 0.1 * k, 1.0, 0.5) for k in range(4)]
    for number, pose in enumerate(odom):
        trail.add(number, np.array(pose))
        if number == 4:
            trail.break_off()
        if number in (0, 6):
            trail.mark_key()
    found = np.array((-3.0, 2.0, 1.0))
    laid = trail.lay(np.stack((np.zeros(3), found)))
    assert laid[:4] == pytest.approx(np.array(odom[:4]))
    for k in range(4, 8):
        assert laid[k] == pytest.approx(se2.compose(found, se2.between(np.array(odom[6]), np.array(odom[k]))))


def test_while_the_laser_is_still_lost_the_odometry_goes_on_as_a_guess():
    trail = Trail()
    for number, pose in enumerate(((0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.0, 0.0))):
        trail.add(number, np.array(pose))
        if number == 0:
            trail.mark_key()
        else:
            trail.break_off()
    assert trail.lay(np.zeros((1, 3)))[:, 0] == pytest.approx([0.0, 0.1, 0.2])
