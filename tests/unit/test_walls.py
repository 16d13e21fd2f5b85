"""Walls between two rays that both met them."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.world import Sick, square_of_corridors
from drivers.world.drive import simulate_scans
from processing.odometry import LaserOdometry, OdometryConfig
from processing.scan import Scan
from processing.wall_kernels import LEAST_SLANT, SPACING_M, STRAIGHT, STRAIGHT_M, fill_walls
from tests.lasers import beams_of_laser


def filled(points, rays, most_m=4.0, room=2000):
    return filled_and_normals(points, rays, most_m, room)[0]


def filled_and_normals(points, rays, most_m, room=2000):
    out, normals = np.empty((room, 2)), np.full((room, 2), np.nan)
    written = fill_walls(
        np.array(points, dtype=np.float64).reshape(-1, 2), np.array(rays), len(rays), most_m, out, normals
    )
    return out[:written], normals[len(rays) : written]


def plainly_filled(points, rays, most_m):
    """The same, as one would write it first."""

    def straight(end, beyond, along):
        if not 0 <= beyond < len(rays) or abs(rays[beyond] - rays[end]) != 1:
            return False
        off = points[beyond] - points[end]
        return abs(off[0] * along[1] - off[1] * along[0]) <= STRAIGHT_M + STRAIGHT * np.hypot(*off)

    out, normals = list(points), []
    for i in range(len(rays) - 1):
        step = points[i + 1] - points[i]
        gap = np.hypot(*step)
        if rays[i + 1] - rays[i] != 1 or not SPACING_M < gap <= most_m:
            continue
        along = step / gap
        slant = abs(points[i][0] * along[1] - points[i][1] * along[0])
        wall = straight(i, i - 1, along) and straight(i + 1, i + 2, along)
        if wall and slant >= LEAST_SLANT * np.hypot(*points[i]):
            pieces = int(np.ceil(gap / SPACING_M))
            out += [points[i] + step * k / pieces for k in range(1, pieces)]
            normal = np.array((along[1], -along[0]))
            normals += [normal if normal @ points[i] < 0.0 else -normal] * (pieces - 1)
    return np.array(out), np.array(normals).reshape(-1, 2)


def hits(wall_y_m, bearings_deg):
    """Where rays at these bearings meet a wall beside the laser."""
    bearing = np.radians(bearings_deg)
    return np.column_stack((wall_y_m / np.tan(bearing), np.full(len(bearing), wall_y_m)))


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 6.0))
def test_the_compiled_filling_is_the_plain_one(seed, most_m):
    rng = np.random.default_rng(seed)
    rays = np.cumsum(rng.integers(1, 3, 40))
    points = hits(1.2, np.linspace(4.0, 60.0, 40)) + rng.normal(0.0, 0.02, (40, 2)) * rng.integers(
        0, 2, (40, 1)
    )
    compiled, plain = filled_and_normals(points, rays, most_m), plainly_filled(points, rays, most_m)
    for one, other in zip(compiled, plain, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-12)


def test_a_far_wall_is_whole_between_its_hits():
    points = hits(1.2, np.arange(5.0, 20.0))
    whole = filled(points, np.arange(15))
    x = np.sort(whole[:, 0])
    # The first and the last gap have no wall on their far side to vouch for them.
    inside = x[(x >= points[-2, 0]) & (x <= points[1, 0])]
    assert np.diff(inside).max() <= SPACING_M + 1e-9
    assert np.diff(points[:, 0]).min() < -2.0
    np.testing.assert_allclose(whole[:, 1], 1.2)


@pytest.mark.parametrize(
    "points",
    [
        # Round a corner, past an edge, along a ray, and a heap.
        [(3.0, 1.0), (3.5, 1.0), (4.0, 1.0), (4.0, 0.4), (4.0, -0.2)],
        [(2.0, 1.0), (2.4, 1.0), (4.0, 1.9), (4.5, 1.9), (5.0, 1.9)],
        [(1.0, 0.0), (2.0, 0.001), (3.0, 0.002), (4.0, 0.003)],
        [(2.0, 0.1), (2.3, -0.2), (2.1, 0.3), (2.6, 0.0), (2.2, 0.2)],
    ],
)
def test_what_is_no_straight_wall_is_not_filled(points):
    np.testing.assert_array_equal(filled(points, np.arange(len(points))), points)


def test_a_missing_ray_and_a_wide_gap_are_left_open():
    points = hits(1.2, np.arange(5.0, 15.0))
    rays = np.arange(10)
    rays[5:] += 1
    open_m = np.array((points[5, 0], points[4, 0]))
    for whole in (filled(points, rays), filled(points, np.arange(10), most_m=0.5 * abs(np.diff(open_m)[0]))):
        inside = (whole[:, 0] > open_m[0] + 0.01) & (whole[:, 0] < open_m[1] - 0.01)
        assert not inside.any()


def test_nothing_is_written_past_the_room():
    points = hits(1.2, np.arange(5.0, 20.0))
    assert len(filled(points, np.arange(15), room=40)) == 40


@pytest.mark.parametrize(("side_m", "speed_mps"), [(40.0, 1.0), (100.0, 0.8)])
def test_a_robot_with_a_coarse_laser_starts_in_a_corridor_without_standing_still(side_m, speed_mps):
    laser = Sick()
    beams = beams_of_laser(laser)
    building = square_of_corridors(side_m)
    drive = list(simulate_scans(building, laser=laser, speed_mps=speed_mps, max_scans=75, seed=0))
    odometry = LaserOdometry(OdometryConfig(), 0)
    for stamp_ns, ranges_m, _ in drive:
        match = odometry.step(Scan(stamp_ns, ranges_m, beams))
    way_m = np.hypot(*(drive[-1][2] - drive[0][2])[:2])
    assert way_m > 10.0
    # Without filled walls it loses nearly two metres of the short side, and held to the certainty of a fast
    # laser ten of the long one.
    assert abs(np.hypot(*match.motion.odom_t_laser[:2]) - way_m) < 0.15
