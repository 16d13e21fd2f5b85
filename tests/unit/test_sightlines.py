"""What earlier scans say of a scan at a place, compiled and plain."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from processing.se2 import invert, transform
from processing.sight_kernels import SLACK, SLACK_M, look_back

SECTORS = 180


def sectors_of(points):
    bearing = np.arctan2(points[:, 1], points[:, 0])
    return np.minimum(((bearing + np.pi) * SECTORS / (2.0 * np.pi)).astype(int), SECTORS - 1)


def plainly(placed, points, ends, poses, most_m):
    """The same with arrays: known (N,), how often looked through, how often looked at."""
    known, before, looks, first = np.zeros(len(placed), bool), 0, 0, 0
    for end, pose in zip(ends, poses, strict=True):
        seen, first = transform(invert(pose), points[first:end]), end
        away = np.hypot(*seen.T)
        nearest = np.full(SECTORS, np.inf)
        near = away < most_m
        np.minimum.at(nearest, sectors_of(seen)[near], away[near])
        here = transform(invert(pose), placed)
        far, wall = np.hypot(*here.T), nearest[sectors_of(here)]
        looked = np.isfinite(wall)
        looks += looked.sum()
        before += (far[looked] + SLACK_M + SLACK * far[looked] < wall[looked]).sum()
        known |= looked & (far <= wall + SLACK_M + SLACK * wall)
    return known, before, looks


@given(st.integers(0, 2**32 - 1), st.integers(0, 4))
def test_the_compiled_look_back_is_the_plain_one(seed, scans):
    rng = np.random.default_rng(seed)
    lengths = rng.integers(1, 60, scans)
    points, placed = rng.uniform(-6.0, 6.0, (int(lengths.sum()), 2)), rng.uniform(-6.0, 6.0, (50, 2))
    poses = rng.uniform(-3.0, 3.0, (scans, 3))
    known, counts = np.empty(50, np.uint8), np.zeros(2, np.int64)
    ends = np.cumsum(lengths).astype(np.int64)
    look_back(placed, points, ends, poses, 5.0, np.empty(SECTORS), known, counts)
    expected, before, looks = plainly(placed, points, ends, poses, 5.0)
    np.testing.assert_array_equal(known.astype(bool), expected)
    assert counts.tolist() == [before, looks]
