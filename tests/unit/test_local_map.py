"""The local map: which way walls face, and what of them is left in the reference."""

import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from drivers.world import Building, Sick, outline, simulate_scans
from processing import facing_kernels as facing
from processing.evaluation import absolute_errors
from processing.local_map import BEHIND_M, BEHIND_SLANT, LocalMap
from processing.ndt import NdtConfig
from processing.odometry import LaserOdometry, OdometryConfig
from processing.scan import Scan
from tests.lasers import beams_of_laser


def faced(points, near_m=facing.NEAR_M, thin=facing.THIN, which=None):
    which = np.arange(len(points)) if which is None else which
    normals = np.full((len(which) + 3, 2), np.nan)
    facing.face(np.ascontiguousarray(points), len(points), which, near_m, thin, normals)
    assert np.isnan(normals[len(which) :]).all()
    return normals[: len(which)]


def plainly_faced(points, near_m=facing.NEAR_M, thin=facing.THIN):
    """The same, as one would write it first: the short axis of the neighbours, turned to the laser."""
    normals = np.zeros_like(points)
    for i, point in enumerate(points):
        reach_m = max(near_m, facing.REACH * np.hypot(*point))
        sides = []
        for side in (points[:i][::-1], points[i + 1 :]):
            sides.append([])
            for k, other in enumerate(side, 1):
                away_m = np.hypot(*(other - point))
                if away_m > reach_m or (away_m > near_m and k > facing.ENOUGH):
                    break
                sides[-1].append(other)
        axes = [short_axis([point, *group]) for group in ([*sides[0], *sides[1]], *sides)]
        ratio, axis = axes[0] if axes[0][0] < thin else min(axes[1:], key=lambda a: a[0])
        if ratio < thin:
            normals[i] = axis * -np.sign(axis @ point)
    return normals


def short_axis(group):
    """Ratio of the variances of points, and the axis of the smaller one."""
    if len(group) < facing.LEAST:
        return np.inf, np.zeros(2)
    values, vectors = np.linalg.eigh(np.cov(np.transpose(group), bias=True))
    return values[0] / values[1], vectors[:, 0]


def wall(x_m, y0_m, y1_m, count=60):
    return np.column_stack((np.full(count, x_m), np.linspace(y0_m, y1_m, count)))


@given(st.integers(0, 2**32 - 1))
def test_the_compiled_normals_are_the_plain_ones(seed):
    rng = np.random.default_rng(seed)
    corner = np.vstack((wall(2.0, -1.5, 1.0, 30), wall(1.0, 2.0, 0.4, 20)[:, ::-1]))
    points = corner * rng.uniform(0.3, 3.0) + rng.normal(0.0, 0.01, corner.shape)
    np.testing.assert_allclose(faced(points), plainly_faced(points), atol=1e-6)
    which = np.flatnonzero(rng.random(len(points)) < 0.3)
    straight = facing.STRAIGHT_M, facing.STRAIGHT
    expected = plainly_faced(points, *straight)[which]
    np.testing.assert_allclose(faced(points, *straight, which), expected, atol=1e-6)


def test_what_is_short_or_bent_is_no_straight_wall():
    noise = np.random.default_rng(3).normal(0.0, 0.003, (60, 2))
    straight = facing.STRAIGHT_M, facing.STRAIGHT
    turn = np.linspace(np.pi - 0.8, np.pi + 0.8, 60)[::-1]
    pillar = np.column_stack((2.0 + 0.2 * np.cos(turn), 0.2 * np.sin(turn)))

    def share(points):
        return (faced(points + noise[: len(points)], *straight) != 0.0).any(axis=1).mean()

    assert share(wall(2.0, -1.0, 1.0)) == 1.0
    assert share(wall(2.0, -0.03, 0.03, 3)) == 0.0
    assert share(pillar) < 0.2


def test_a_wall_faces_the_laser_and_a_heap_faces_nowhere():
    np.testing.assert_allclose(faced(wall(2.0, -1.0, 1.0)), np.tile((-1.0, 0.0), (60, 1)), atol=1e-9)
    heap = np.random.default_rng(1).normal((2.0, 0.0), 0.05, (40, 2))
    assert (faced(heap) == 0.0).all(axis=1).mean() > 0.7
    assert (faced(heap[:3]) == 0.0).all()
    assert faced(np.zeros((0, 2))).shape == (0, 2)


def test_a_wall_faces_the_laser_up_to_its_corner():
    # The wall beside a door, and the jamb: half the thickness of a wall.
    beside, jamb = wall(1.0, 1.5, 0.45, 80), np.column_stack((np.linspace(1.0, 1.1, 20), np.full(20, 0.45)))
    noise = np.random.default_rng(2).normal(0.0, 0.003, (100, 2))
    normals = faced(np.vstack((beside, jamb)) + noise)
    assert (normals[:79] @ (-1.0, 0.0) > 0.95).all()
    assert (normals[84:89] @ (0.0, -1.0) > 0.95).all()


def leaned(points, rays, increment_rad, normals=None):
    normals = np.zeros((len(points), 2)) if normals is None else normals
    facing.lean(points, rays, len(points), np.arange(len(points)), increment_rad, normals)
    return normals


@given(st.integers(0, 2**32 - 1))
def test_lone_far_hits_are_those_of_the_plain_twin(seed):
    rng = np.random.default_rng(seed)
    increment_rad = float(rng.uniform(0.002, 0.03))
    rays = np.flatnonzero(rng.random(120) < 0.8)
    ranges_m = np.repeat(rng.uniform(0.5, 60.0, 40), 3)[rays] + rng.normal(0.0, 0.02, len(rays))
    points = ranges_m[:, None] * np.column_stack((np.cos(increment_rad * rays), np.sin(increment_rad * rays)))
    normals = np.where(rng.random((len(points), 1)) < 0.2, (0.6, 0.8), 0.0)
    expected = normals.copy()
    for i, point in enumerate(points):
        square_m = increment_rad * np.hypot(*point)
        beside = [j for j in (i - 1, i + 1) if 0 <= j < len(rays) and abs(rays[j] - rays[i]) == 1]
        near = any(np.hypot(*(points[j] - point)) < facing.GRAZING * square_m for j in beside)
        if not normals[i].any() and square_m > facing.LONE_M and not near:
            expected[i] = facing.SHORT * np.array((-point[1], point[0])) / np.hypot(*point)
    np.testing.assert_allclose(leaned(points, rays, increment_rad, normals), expected, atol=1e-12)


def test_the_last_rays_along_a_corridor_tell_across_them_and_its_end_and_a_post_tell_all():
    rays = np.arange(-4, 5)
    rays = rays[rays != 0]
    bearings = np.radians(rays)
    directions = np.column_stack((np.cos(bearings), np.sin(bearings)))
    sides = directions * (1.08 / np.abs(np.sin(bearings)))[:, None]
    across = (leaned(sides, rays, np.radians(1.0)) * directions).sum(axis=1)
    np.testing.assert_allclose(across, 0.0, atol=1e-12)
    assert (leaned(sides, rays, np.radians(1.0)) != 0.0).any(axis=1).all()
    end = directions * (20.0 / np.cos(bearings))[:, None]
    assert (leaned(end, rays, np.radians(1.0))[2:6] == 0.0).all()
    # Nothing is nearer to a thin thing than what is behind it, and yet it stands there.
    post = np.vstack((sides[:3], (3.0, 0.0), sides[5:]))
    assert (leaned(post, np.array((-4, -3, -2, 0, 2, 3, 4)), np.radians(1.0))[3] == 0.0).all()


@given(st.integers(0, 2**32 - 1))
def test_what_is_seen_from_behind_is_that_of_the_plain_twin(seed):
    rng = np.random.default_rng(seed)
    points, place = rng.uniform(-3.0, 3.0, (50, 2)), rng.uniform(-3.0, 3.0, 2)
    angle = rng.uniform(-np.pi, np.pi, 50)
    normals = np.column_stack((np.cos(angle), np.sin(angle))) * rng.integers(0, 2, (50, 1))
    behind = np.zeros(50, np.bool_)
    count = facing.look_behind(points, normals, *place, 0.05, 0.1, behind)
    off = place - points
    beyond = -(off * normals).sum(axis=1) - 0.05
    expected = (beyond > 0.0) & (beyond > 0.1 * np.hypot(*off.T))
    np.testing.assert_array_equal(behind, expected)
    assert count == expected.sum()


def shown(local, points):
    """How well points fit the reference where they are."""
    return local.reference.score(points, np.zeros(3)).value / len(points)


def local_map():
    """A wall at x = 2, seen from the origin and again from near it."""
    local, points = LocalMap(NdtConfig(), 5), wall(2.0, -1.0, 1.0)
    for x_m in (0.0, 1.0):
        there = points - (x_m, 0.0)
        local.add(np.array((x_m, 0.0, 0.0)), there, faced(there))
    return local, points


def test_a_wall_is_left_out_for_a_laser_behind_it_and_shown_again_before_it():
    local, points = local_map()
    assert shown(local, points) > 0.8
    local.face(np.array((2.3, 0.0, 0.0)))
    assert shown(local, points) == 0.0
    local.face(np.array((1.7, 0.0, 0.0)))
    assert shown(local, points) > 0.8


def test_noise_of_the_place_and_of_the_normal_does_not_hide_a_wall():
    local, points = local_map()
    local.face(np.array((2.0 + 0.9 * BEHIND_M, 0.0, 0.0)))
    assert shown(local, points) > 0.8
    # Along the wall, with its normal a little wrong.
    aside = np.array((2.0 + 0.9 * (BEHIND_M + 3.0 * BEHIND_SLANT), 4.0, 0.0))
    local.face(aside)
    assert shown(local, points) > 0.8


def test_a_lost_laser_may_be_on_either_side():
    local, points = local_map()
    local.face(np.array((2.3, 0.0, 0.0)))
    local.show_all()
    assert shown(local, points) > 0.8
    # Until there is a new key scan, which knows where it is.
    local.face(np.array((2.3, 0.0, 0.0)))
    assert shown(local, points) > 0.8
    there = wall(1.0, -1.0, 1.0)
    local.add(np.array((2.3, 0.0, 0.0)), there, faced(there))
    assert shown(local, points) == 0.0


def test_a_map_without_sides_is_shown_whole_and_the_oldest_scan_goes():
    local, points = LocalMap(NdtConfig(), 1, sides=False), wall(2.0, -1.0, 1.0)
    local.add(np.zeros(3), points, faced(points))
    local.face(np.array((2.3, 0.0, 0.0)))
    assert shown(local, points) > 0.8
    local.add(np.array((5.0, 0.0, 0.0)), points, faced(points))
    assert len(local.keys) == 1
    assert shown(local, points) == 0.0
    local.clear()
    assert local.keys == []


def test_a_copy_goes_on_as_the_original():
    local, points = local_map()
    local.face(np.array((2.3, 0.0, 0.0)))
    copy = pickle.loads(pickle.dumps(local))
    assert shown(copy, points) == 0.0
    for one in (local, copy):
        one.face(np.array((1.7, 0.0, 0.0)))
    assert shown(copy, points) == shown(local, points) > 0.8


@pytest.mark.parametrize("wall_m", [0.1, 0.2])
def test_who_turns_round_in_a_room_is_not_off_by_the_thickness_of_its_wall(wall_m):
    # Out of a corridor through a door into a room, round, and back: half a circle of sight at five hertz.
    free = [(0.0, 0.0, 12.0, 2.2), (3.9, 2.2 + wall_m, 9.9, 5.2 + wall_m), (5.55, 2.2, 6.45, 2.2 + wall_m)]
    way = np.array(((1.0, 1.1), (6.0, 1.1), (6.0, 3.7 + wall_m), (6.0, 1.1), (11.0, 1.1)))
    building, laser = Building(outline(free), route=way), Sick()
    beams = beams_of_laser(laser)
    drive = list(simulate_scans(building, laser=laser, speed_mps=0.6, turn_rate_radps=1.2, seed=0))
    worst_m = []
    for sides in (True, False):
        odometry = LaserOdometry(OdometryConfig(walls_have_sides=sides), 0)
        poses = [
            odometry.step(Scan(stamp, ranges_m, beams)).motion.odom_t_laser for stamp, ranges_m, _ in drive
        ]
        errors = absolute_errors(np.array([pose for *_, pose in drive]), np.array(poses))
        worst_m.append(errors.translation_m.max())
    assert worst_m[0] < 0.03
    assert worst_m[1] > 0.7 * wall_m
