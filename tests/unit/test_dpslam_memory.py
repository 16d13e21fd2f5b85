"""Key scans are kept as they were seen, and as many as the ground asks for."""

import numpy as np

from processing.dpslam.memory import CHUNK, MOST_SCANS, KeyScans
from processing.dpslam.sweep import NOTHING_SEEN, Sweeper
from processing.motion import Motion
from processing.scan import Beams, Scan, end_points

BEAMS = Beams(
    count=91, angle_min_rad=-1.5, angle_increment_rad=1 / 30, time_increment_s=1e-3, range_max_m=9.0
)


def sweep_of(seed, twist=(0.4, -0.1, 0.7)):
    rng = np.random.default_rng(seed)
    ranges_m = rng.uniform(0.5, 12.0, BEAMS.count).astype(np.float32)
    ranges_m[::7] = np.nan
    scan = Scan(seed, ranges_m, BEAMS)
    motion = Motion(seed, np.zeros(3), np.eye(3), np.array(twist))
    return scan, motion, Sweeper(BEAMS, 40, 30.0).take(scan, motion)


def test_rays_start_where_the_laser_was_and_end_where_the_points_are():
    scan, motion, sweep = sweep_of(1)
    points, numbers = end_points(scan, motion.twist)
    assert np.array_equal(sweep.numbers, numbers)
    assert np.allclose(sweep.rays[:, 2:], points, atol=1e-9)
    # Ray k leaves k ms after the first, from a laser that has turned and moved that long.
    last = int(sweep.numbers[-1]) * 1e-3
    assert np.allclose(sweep.rays[-1, :2], (0.4 * last, -0.1 * last), atol=2e-3)
    lengths = np.hypot(*(sweep.rays[:, 2:] - sweep.rays[:, :2]).T)
    assert np.allclose(lengths, scan.ranges_m[numbers], atol=1e-6)


def test_what_is_drawn_anew_is_to_the_bit_what_was_seen():
    scans, sweeps = KeyScans(), [sweep_of(seed)[2] for seed in range(CHUNK + 3)]
    for number, sweep in enumerate(sweeps):
        scans.add(sweep, np.array((float(number), 0.0, 0.0)))
    at = 0
    for rays, ends in scans.rays(BEAMS):
        for k in range(len(ends) - 1):
            assert np.array_equal(rays[ends[k] : ends[k + 1]], sweeps[at].rays)
            at += 1
    assert at == len(scans) == CHUNK + 3


def test_of_one_place_only_the_newest_scans_are_kept():
    scans, used = KeyScans(), []
    for seed in range(5 * MOST_SCANS):
        replaced = scans.add(sweep_of(seed)[2], np.array((0.3, 0.2, 0.1)))
        assert replaced == (seed - MOST_SCANS if seed >= MOST_SCANS else None)
        used.append(scans.bytes_used)
    assert used[-1] < 1.2 * used[MOST_SCANS]
    assert used[-1] == sum(6 * len(numbers) for numbers in scans._numbers)
    ((_, ends),) = scans.rays(BEAMS)
    assert np.count_nonzero(np.diff(ends)) == MOST_SCANS
    # Another place, and another heading at the same place, are their own.
    assert scans.add(sweep_of(98)[2], np.array((1.3, 0.2, 0.1))) is None
    assert scans.add(sweep_of(99)[2], np.array((0.3, 0.2, 3.1))) is None


def test_a_key_scan_of_nothing_is_counted_and_empty():
    scans = KeyScans()
    scans.add(NOTHING_SEEN, np.zeros(3))
    ((rays, ends),) = scans.rays(BEAMS)
    assert rays.shape == (0, 4)
    assert ends.tolist() == [0, 0]


def test_a_restored_memory_goes_on_as_the_first_one():
    scans, twin = KeyScans(), KeyScans()
    for seed in range(20):
        scans.add(sweep_of(seed)[2], np.array((0.1 * seed, 0.0, 0.0)))
    twin.restore(scans.state())
    for seed in range(20, 45):
        pose = np.array((0.05 * seed, 0.0, 0.0))
        assert scans.add(sweep_of(seed)[2], pose) == twin.add(sweep_of(seed)[2], pose)
    assert twin.bytes_used == scans.bytes_used
    one, other = scans.state(), twin.state()
    assert all(np.array_equal(one[name], other[name]) for name in one)
