"""A corridor is reported as a corridor: what is not seen keeps the motion, and says how wide it is open."""

from dataclasses import replace

import numpy as np
import pytest

from drivers.world.drive import simulate_scans
from drivers.world.generators import corridor, room
from drivers.world.laser import Urg04lx
from processing.observability import BLIND_M, SPEED_ERROR_M_S, UNSEEN_SPEED_M_S, Blindness, view
from processing.odometry import LaserOdometry, OdometryConfig, Tracking
from processing.scan import Scan
from tests.lasers import beams_of_laser


def information(deviations, yaw_rad=0.0):
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    return turn @ np.diag(1.0 / np.square(deviations)) @ turn.T


@pytest.mark.parametrize("yaw_rad", [0.0, 0.7, -2.0])
def test_the_direction_of_a_corridor_is_found_on_any_heading(yaw_rad):
    seen = view(information((0.5, 0.005, 0.003), yaw_rad))
    assert seen.unseen.shape == (1, 2)
    along = np.array((np.cos(yaw_rad), np.sin(yaw_rad)))
    assert abs(seen.unseen[0] @ along) == pytest.approx(1.0)
    assert along @ seen.information[:2, :2] @ along == pytest.approx(0.0, abs=1e-6)
    across = np.array((-along[1], along[0]))
    assert across @ seen.information[:2, :2] @ across == pytest.approx(1.0 / 0.005**2)


def test_a_room_is_seen_wholly():
    seen = view(information((0.02, 0.01, 0.003)))
    assert len(seen.unseen) == 0
    np.testing.assert_allclose(seen.information, information((0.02, 0.01, 0.003)))
    np.testing.assert_array_equal(seen.hold(np.array((1.0, 2.0, 3.0)), np.zeros(3)), (1.0, 2.0, 3.0))


def test_without_walls_nothing_is_seen():
    assert len(view(np.zeros((3, 3))).unseen) == 2


def test_a_position_that_hangs_on_the_yaw_is_not_seen():
    # Each alone is well known; but turning and shifting together nobody would notice.
    lever = np.array((1.0, 0.0, 1.0))
    assert len(view(1e4 * np.outer(lever, lever) + np.diag((0.0, 1e4, 0.0))).unseen) == 1


def test_the_motion_is_held_along_the_corridor_and_corrected_across_it():
    seen = view(information((2.0 * BLIND_M, 0.005, 0.003)))
    held = seen.hold(np.array((1.0, 0.5, 0.1)), np.array((1.2, 0.4, 0.0)))
    np.testing.assert_allclose(held, (1.2, 0.5, 0.1))


def test_the_covariance_is_wide_along_and_only_along():
    wide = Blindness().widened(np.diag((1e-5, 2e-5, 1e-6)), np.array(((0.0, 1.0),)), 0.1, 0.0)
    assert wide[0, 0] == pytest.approx(1e-5)
    assert wide[1, 1] == pytest.approx((0.1 * UNSEEN_SPEED_M_S) ** 2)
    assert wide[2, 2] == pytest.approx(1e-6)


def test_an_error_of_the_velocity_adds_up_along_the_way_until_it_is_seen_again():
    exact, along, none = np.zeros((3, 3)), np.array(((1.0, 0.0),)), np.zeros((0, 2))
    blindness = Blindness()
    strayed = [sum(blindness.widened(exact, along, 0.1, 0.0)[0, 0] for _ in range(30)) for _ in range(2)]
    # Three seconds of it, and twice as far after six.
    assert np.sqrt(strayed[0]) == pytest.approx(3.0 * UNSEEN_SPEED_M_S)
    assert np.sqrt(sum(strayed)) == pytest.approx(6.0 * UNSEEN_SPEED_M_S)
    np.testing.assert_array_equal(blindness.widened(exact, none, 0.1, 8.0), exact)
    # Once it was seen for a while it is known better, and a blink costs nearly nothing.
    assert np.sqrt(blindness.widened(exact, along, 0.1, 8.0)[0, 0]) == pytest.approx(0.1 * SPEED_ERROR_M_S)


def test_a_velocity_is_known_the_better_the_longer_it_was_steady_when_the_view_ended():
    exact, along = np.zeros((3, 3)), np.array(((1.0, 0.0),))
    strayed_m = [
        np.sqrt(Blindness().widened(exact, along, 1.0, steady_s)[0, 0])
        for steady_s in (0.0, 0.5, 1.0, 2.0, 8.0)
    ]
    assert strayed_m == pytest.approx((UNSEEN_SPEED_M_S, 0.12, 0.06, SPEED_ERROR_M_S, SPEED_ERROR_M_S))
    # A sharp turn ends that, and nothing unseen brings it back.
    blindness = Blindness()
    strayed = [blindness.widened(exact, along, 1.0, steady_s)[0, 0] for steady_s in (2.0, 0.0, 8.0)]
    assert strayed[0] == pytest.approx(SPEED_ERROR_M_S**2)
    assert sum(strayed[1:]) == pytest.approx((3.0**2 - 1.0) * UNSEEN_SPEED_M_S**2)


def drive(building, most, **options):
    laser = Urg04lx()
    beams = replace(beams_of_laser(laser), range_max_m=5.6)
    odometry = LaserOdometry(OdometryConfig(), 1)
    scans = simulate_scans(building, laser=laser, max_scans=most, **options)
    return [odometry.step(Scan(stamp_ns, ranges, beams)) for stamp_ns, ranges, _ in scans]


def test_a_plain_corridor_is_degenerate_along_itself():
    matches = drive(corridor(40.0, 2.0), 250)
    in_the_middle = matches[180:]
    assert all(match.state is Tracking.DEGENERATE for match in in_the_middle)
    assert all(abs(match.blind_rad) < np.radians(3.0) for match in in_the_middle)
    for match in in_the_middle:
        along, across, yaw = np.sqrt(np.diag(match.motion.covariance))
        assert along > 10.0 * across
        assert yaw < 0.02


def test_a_room_is_never_degenerate():
    matches = drive(room(), 150)
    assert {match.state for match in matches} == {Tracking.TRACKING}
    assert all(match.blind_rad is None for match in matches)
