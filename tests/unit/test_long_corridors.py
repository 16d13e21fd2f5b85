"""A laser of a degree and eighty metres in corridors where it sees little: it must not be held."""

import numpy as np
import pytest

from drivers.world import Building, Sick, outline, simulate_scans
from processing.odometry import LaserOdometry, OdometryConfig, Tracking
from processing.scan import Scan
from tests.lasers import beams_of_laser

LASER = Sick()
HALF_M, DEEP_M, DOOR_M = 1.08, 0.1, 0.9


def door(x_m, side):
    """A door: the wall is a little deeper there."""
    low, high = sorted((side * HALF_M, side * (HALF_M + DEEP_M)))
    return (x_m, low, x_m + DOOR_M, high)


def follow(rectangles, way, scans, seed):
    """How far each motion of a drive at walking pace is off, and what is claimed of it; m."""
    building = Building(outline(rectangles), route=np.array(way))
    odometry, beams = LaserOdometry(OdometryConfig(), seed), beams_of_laser(LASER)
    course = list(
        simulate_scans(building, laser=LASER, speed_mps=0.8, rest_s=0.0, max_scans=scans, seed=seed)
    )
    matches = [odometry.step(Scan(stamp_ns, ranges_m, beams)) for stamp_ns, ranges_m, _ in course]
    found = np.array([match.motion.odom_t_laser[0] for match in matches])
    true = np.array([pose[0] for *_, pose in course])
    return np.diff(found) - np.diff(true), [match.state for match in matches[1:]]


@pytest.mark.parametrize("seed", [0, 2])
def test_out_of_a_room_and_along_a_corridor_of_few_doors_it_never_stands_still(seed):
    places_m = np.random.default_rng(seed).uniform(2.0, 100.0, (2, 8))
    doors = [door(x_m, side) for side, row in zip((1.0, -1.0), places_m, strict=True) for x_m in row]
    rooms = [(-6.0, -3.0, 0.0, 3.0), (-0.01, -HALF_M, 160.0, HALF_M)]
    off_m, states = follow([*rooms, *doors], ((-3.0, 0.0), (100.0, 0.0)), 620, seed)
    tracking = np.array([state is Tracking.TRACKING for state in states])
    assert np.abs(off_m[tracking]).max() < 0.12
    # It goes on as it went when it last saw how fast: after a hundred metres, off by a few in a hundred.
    assert np.abs(np.cumsum(off_m)).max() < 3.0


@pytest.mark.parametrize("count", [4, 8])
def test_who_sets_out_where_little_is_in_sight_is_found_when_it_cannot_be_where_it_was(count):
    doors = [door(3.0 + 4.1 * k, 1.0) for k in range(count)]
    doors += [door(5.0 + 3.7 * k, -1.0) for k in range(count)]
    off_m, _ = follow([(0.0, -HALF_M, 160.0, HALF_M), *doors], ((1.0, 0.0), (85.0, 0.0)), 520, 3)
    assert np.abs(np.cumsum(off_m)).max() < 1.5
