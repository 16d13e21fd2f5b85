"""The covariance of a motion is what its residuals and rays say: against plain sums, and against truth."""

import numpy as np
import pytest

from processing.certainty import Certainty, RayNoise
from processing.certainty_kernels import spreads
from processing.matching import Matcher, MatchingConfig
from processing.ndt import Ndt, NdtConfig
from processing.odometry import LaserOdometry, OdometryConfig
from processing.prediction import Prior
from processing.scan import Beams, Scan
from processing.se2 import between, compose

BEAMS = Beams(
    count=682,
    angle_min_rad=-2.0862,
    angle_increment_rad=2.0 * np.pi / 1024,
    time_increment_s=0.0,
    period_s=0.1,
    range_max_m=8.0,
)


def room(count, rng, noise_m=0.01):
    """Points (N, 2) of the walls of a room of 4 by 3 m."""
    along = rng.uniform(0.0, 14.0, count)
    corners = np.array(((-2.0, -1.5), (2.0, -1.5), (2.0, 1.5), (-2.0, 1.5), (-2.0, -1.5)))
    starts = np.array((0.0, 4.0, 7.0, 11.0, 14.0))
    x, y = (np.interp(along, starts, corners[:, k]) for k in (0, 1))
    return np.column_stack((x, y)) + rng.normal(0.0, noise_m, (count, 2))


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_the_spreads_are_the_sums_over_single_points(share):
    rng = np.random.default_rng(1)
    ndt = Ndt(NdtConfig())
    ndt.build(room(2000, rng))
    angle = rng.uniform(-np.pi, np.pi, 60)
    normals = np.column_stack((np.cos(angle), np.sin(angle))) * rng.integers(0, 2, (60, 1))
    points, pose = np.hstack((room(60, rng), normals)), np.array((0.03, -0.02, 0.01))
    out = np.empty((2, 3, 3))
    spreads(points, ndt.grid, ndt.fine.grid, share, pose, out)
    residual, white = np.zeros((3, 3)), np.zeros((3, 3))
    for point in points:
        wide, fine = ndt.score(point[None], pose), ndt.fine.score(point[None], pose)
        slope = (1.0 - share) * wide.gradient + share * fine.gradient
        residual += np.outer(slope, slope)
        # Columns x and y of the Hessian are how the slope changes with the place of the point, on map axes;
        # its last row holds the turn of the lever as well, which the noise of a point does not change.
        hessian = (1.0 - share) * wide.hessian + share * fine.hessian
        c, s = np.cos(pose[2]), np.sin(pose[2])
        rx, ry = c * point[0] - s * point[1], s * point[0] + c * point[1]
        lever = np.array(((1.0, 0.0, -ry), (0.0, 1.0, rx)))
        change = hessian[:2, :2] @ lever
        white += change.T @ change
    np.testing.assert_allclose(out[0], residual, rtol=1e-9, atol=1e-6)
    np.testing.assert_allclose(out[1], white, rtol=1e-9, atol=1e-6)


def wall_scan(rng, noise_m):
    """A scan of a straight wall 2 m to the left and one 1 m to the right."""
    s = np.sin(BEAMS.bearings())
    with np.errstate(divide="ignore"):
        ranges = np.where(s > 0, 2.0 / s, -1.0 / s)
    ranges = ranges + rng.normal(0.0, noise_m, BEAMS.count)
    return Scan(0, np.where(ranges < 8.0, ranges, np.inf).astype(np.float32), BEAMS)


@pytest.mark.parametrize("noise_m", [0.004, 0.02])
@pytest.mark.parametrize("rays", [1, 5])
def test_the_noise_of_the_rays_is_read_from_a_wall(noise_m, rays):
    rng = np.random.default_rng(3)
    noise = RayNoise()
    for _ in range(40):
        variance = noise.watch(wall_scan(rng, noise_m), rays)
    assert np.sqrt(variance * rays) == pytest.approx(noise_m, rel=0.35)


def test_the_noise_of_a_ray_is_that_whatever_is_averaged():
    rng = np.random.default_rng(3)
    noise = RayNoise()
    assert noise.ray_m == 0.0
    for _ in range(40):
        noise.watch(wall_scan(rng, 0.02), 5)
    assert noise.ray_m == pytest.approx(0.02, rel=0.35)


def test_nothing_seen_leaves_the_noise_unknown_but_not_nothing():
    empty = Scan(0, np.full(BEAMS.count, np.nan, np.float32), BEAMS)
    assert 0.0 < RayNoise().watch(empty, 5) < 0.1


def test_points_that_slide_are_less_certain_than_points_that_stand():
    rng = np.random.default_rng(4)
    ndt = Ndt(NdtConfig())
    ndt.build(room(2000, rng))
    points, scan = room(134, rng), wall_scan(rng, 0.004)
    matching = Matcher(MatchingConfig(), 1).match(points, ndt, Prior(np.zeros(3), np.eye(3)))
    still, driving = np.zeros(3), np.array((0.4, 0.0, 0.0))

    def judged(twist):
        judge = Certainty(1.0, 0.5)
        return judge.judge(scan, 670, points, matching, ndt, (twist, twist), 0.03)

    for covariance in (judged(still), judged(driving)):
        np.testing.assert_allclose(covariance, covariance.T)
        assert np.linalg.eigvalsh(covariance).min() > 0.0
    assert np.trace(judged(driving)) > 1.5 * np.trace(judged(still))


def test_errors_of_motions_lie_where_their_covariance_says():
    """NEES against truth in a room, over a slow drive: not half, not double."""
    rng = np.random.default_rng(5)
    odometry = LaserOdometry(OdometryConfig(), 1)
    truth, found, covariances = [np.zeros(3)], [], []
    for _ in range(120):
        truth.append(compose(truth[-1], np.array((0.015, 0.0, 0.01))))
    for k, pose in enumerate(truth):
        match = odometry.step(Scan(100_000_000 * k, look(pose, rng), BEAMS))
        found.append(match.motion.odom_t_laser)
        covariances.append(match.motion.covariance)
    step = between(np.array(truth)[:-1], np.array(truth)[1:])
    error = between(step, between(np.array(found)[:-1], np.array(found)[1:]))[10:]
    nees = np.einsum("ni,nij,nj->n", error, np.linalg.inv(np.array(covariances)[11:]), error)
    assert np.mean(nees < 7.815) >= 0.85
    assert 0.5 < np.median(nees) < 5.0


def look(pose, rng):
    """Return ranges from a pose in a room of 6 by 5 m around the origin; no ray of a sweep is later."""
    angle = BEAMS.bearings() + pose[2]
    c, s = np.cos(angle), np.sin(angle)
    with np.errstate(divide="ignore"):
        across = np.where(c > 0, (3.0 - pose[0]) / c, (-3.0 - pose[0]) / c)
        along = np.where(s > 0, (2.5 - pose[1]) / s, (-2.5 - pose[1]) / s)
    return (np.minimum(across, along) + rng.normal(0.0, 0.005, BEAMS.count)).astype(np.float32)
