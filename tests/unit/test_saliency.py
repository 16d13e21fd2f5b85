"""A sweep becomes few points: even on walls, dense in corners, and nowhere pushed to one side."""

import numpy as np
import pytest

from drivers.world import Urg04lx, corridor, room
from processing.saliency import Resampler, ResamplingConfig
from processing.saliency_kernels import resample
from processing.scan import Beams, Scan

STILL = np.zeros(3)
LASER = Urg04lx()
BEAMS = Beams(
    count=LASER.beams,
    angle_min_rad=LASER.angle_min_rad,
    angle_increment_rad=LASER.angle_increment_rad,
    period_s=LASER.period_s,
    range_max_m=5.6,
)


def see(building, pose, seed):
    return LASER.measure(building, np.tile(pose, (LASER.beams, 1)), np.random.default_rng(seed))


def resampled(ranges_m, beams=BEAMS, config=None):
    resampler = Resampler(config or ResamplingConfig(), beams)
    points = resampler.points(Scan(0, np.asarray(ranges_m, np.float32), beams), STILL).copy()
    return points, resampler.means()


def with_members(ranges_m, wanted=134):
    """All points, the means, and how many points each mean has, straight from the compiled loop."""
    points, _ = resampled(ranges_m)
    c = ResamplingConfig()
    numbers = (
        c.max_slant,
        c.range_noise_m,
        c.bend_support_m,
        c.bend_weight,
        c.short_weight,
        c.short_m,
    )
    valid = np.flatnonzero((ranges_m >= BEAMS.range_min_m) & (ranges_m <= BEAMS.range_max_m))
    means, members, work = np.empty_like(points), np.empty(len(points), np.int64), np.empty((len(points), 4))
    step = BEAMS.angle_increment_rad
    written = resample(points, valid, len(points), step, wanted, np.array(numbers), means, members, work)
    return points, means[:written], members[:written]


@pytest.mark.parametrize("width_m", [1.5, 2.0, 2.4])
def test_a_sweep_in_a_corridor_becomes_about_134_points(width_m):
    counts = []
    for seed in range(10):
        pose = (8.0 + 0.1 * seed, width_m / 2, 0.1 * seed - 0.5)
        points, means = resampled(see(corridor(20.0, width_m), pose, seed))
        assert len(points) > 500
        counts.append(len(means))
    # Never more than wanted; fewer by what a whole stretch in every piece leaves, under a tenth.
    assert max(counts) <= 134
    assert min(counts) > 120
    assert np.mean(counts) > 128


@pytest.mark.parametrize("wanted", [20, 134, 300])
def test_the_number_is_as_wanted_in_a_room_too(wanted):
    config = ResamplingConfig(points=wanted)
    for seed in range(5):
        _, means = resampled(see(room(furniture=False), (2.5, 2.0, 0.7 * seed), seed), config=config)
        assert 0.9 * wanted <= len(means) <= wanted


def test_no_number_keeps_every_point():
    points, means = resampled(see(room(), (1.5, 1.5, 0.3), 0), config=ResamplingConfig(points=0))
    np.testing.assert_array_equal(points, means)


@pytest.mark.parametrize("seed", range(5))
def test_every_point_is_in_the_mean_of_one_stretch_of_its_neighbours(seed):
    ranges = see(room(), (1.5, 1.5, 0.7 * seed), seed)
    points, means, members = with_members(ranges)
    assert members.min() >= 1
    assert members.sum() == len(points)
    ends = np.cumsum(members)
    for mean, begin, end in zip(means, ends - members, ends, strict=True):
        np.testing.assert_allclose(mean, points[begin:end].mean(axis=0), atol=1e-12)
    np.testing.assert_array_equal(means, resampled(ranges)[1])


def wall_ranges(distance_m, angle_rad, half_rad, noise_m=0.0, seed=0):
    """Ranges to a straight wall whose foot lies in the direction `angle_rad`."""
    off = BEAMS.bearings() - angle_rad
    ranges = np.where(np.abs(off) < half_rad, distance_m / np.cos(np.minimum(np.abs(off), half_rad)), np.nan)
    return ranges + noise_m * np.random.default_rng(seed).standard_normal(len(ranges))


def test_a_straight_wall_is_even_though_its_rays_are_not():
    points, means = resampled(wall_ranges(1.0, 0.0, np.radians(65)), config=ResamplingConfig(points=30))
    ray_gaps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    gaps = np.linalg.norm(np.diff(means, axis=0), axis=1)[1:-1]
    assert ray_gaps.max() > 4.0 * ray_gaps.min()
    # A stretch ends at a ray: the means are as even as the rays allow.
    assert gaps.max() - gaps.min() < 2.0 * ray_gaps.max()
    assert gaps.max() < 1.35 * gaps.min()


def gap_at(means, place):
    """Mean distance between neighbouring means in the half metre around a place."""
    near = np.linalg.norm(0.5 * (means[1:] + means[:-1]) - place, axis=1) < 0.25
    return np.linalg.norm(np.diff(means, axis=0), axis=1)[near].mean()


def test_corners_are_denser_than_walls():
    # A right angle whose corner lies 2 m ahead, its walls 1.41 m away to both sides.
    bearings = BEAMS.bearings()
    foot = np.where(bearings > 0.0, np.pi / 4, -np.pi / 4)
    off = np.minimum(np.abs(bearings - foot), 1.2)
    ranges = np.where(np.abs(bearings) < 1.6, np.sqrt(2.0) / np.cos(off), np.nan)
    _, means = resampled(ranges, config=ResamplingConfig(points=60))
    corner = gap_at(means, np.array((2.0, 0.0)))
    for wall in ((1.0, 1.0), (1.0, -1.0)):
        assert corner < 0.75 * gap_at(means, np.array(wall))
    _, plain = resampled(ranges, config=ResamplingConfig(points=60, bend_weight=0.0))
    assert gap_at(plain, np.array((2.0, 0.0))) > 0.85 * gap_at(plain, np.array((1.0, 1.0)))


def test_short_pieces_are_denser_than_walls():
    ranges = wall_ranges(2.0, 0.0, 1.1)
    bearings = BEAMS.bearings()
    # A post of 0.2 m stands a metre before the wall.
    post = np.abs(bearings) < 0.1
    ranges[post] = 1.0 / np.cos(bearings[post])

    def share(short_weight):
        config = ResamplingConfig(points=60, bend_weight=0.0, short_weight=short_weight)
        _, means = resampled(ranges, config=config)
        on_post = np.abs(means[:, 0] - 1.0) < 0.1
        gaps = np.linalg.norm(np.diff(means, axis=0), axis=1)
        return gaps[on_post[1:] & on_post[:-1]].mean() / gap_at(means, np.array((2.0, 1.5)))

    assert share(2.0) < 0.65
    assert share(0.0) > 0.65


def test_surfaces_apart_are_never_mixed_into_one_point():
    ranges = wall_ranges(2.0, 0.0, 1.1)
    near = np.abs(BEAMS.bearings()) < 0.2
    ranges[near] = 1.0
    for wanted in (10, 50, 134):
        _, means = resampled(ranges, config=ResamplingConfig(points=wanted))
        assert np.all((np.abs(means[:, 0] - 2.0) < 1e-3) | (np.linalg.norm(means, axis=1) < 1.001))


@pytest.mark.parametrize("seed", range(3))
def test_each_point_knows_how_far_its_surface_reaches(seed):
    ranges = wall_ranges(2.0, 0.0, 1.1)
    bearings = BEAMS.bearings()
    ranges[np.abs(bearings - 0.3) < 0.05] = 1.0
    ranges[np.abs(bearings + 0.4) < 0.1] = 1.2
    ranges += np.random.default_rng(seed).normal(0.0, 0.005, len(ranges)).astype(np.float32)
    resampler = Resampler(ResamplingConfig(), BEAMS)
    resampler.points(Scan(0, ranges, BEAMS), STILL)
    means = resampler.means()
    spans = resampler.spans_m(len(means))
    away = np.linalg.norm(means, axis=1)
    post, pillar = (away > 0.9) & (away < 1.1), (away > 1.1) & (away < 1.3)
    assert post.any()
    assert pillar.any()
    np.testing.assert_allclose(spans[post], 0.1, atol=0.03)
    np.testing.assert_allclose(spans[pillar], 0.24, atol=0.03)
    # The wall is cut in three by what stands before it.
    assert spans[~post & ~pillar].min() > 0.5


@pytest.mark.parametrize("wanted", [0, 134])
def test_a_mean_knows_the_wall_that_it_is_on(wanted):
    resampler = Resampler(ResamplingConfig(points=wanted), BEAMS)
    resampler.points(Scan(0, see(room(), (2.0, 2.0, 0.0), 1), BEAMS), STILL)
    means = resampler.means()
    oriented = resampler.oriented_means()
    np.testing.assert_array_equal(oriented[:, :2], means)
    np.testing.assert_array_equal(resampler.oriented_means(walls=False), np.hstack((means, 0.0 * means)))
    normals = oriented[(oriented[:, 2:] != 0.0).any(axis=1), 2:]
    assert len(normals) > 0.5 * len(means)
    np.testing.assert_allclose(np.hypot(*normals.T), 1.0)
    # The laser stands square in a square room, and walls face it.
    assert (np.abs(normals).max(axis=1) > 0.98).mean() > 0.95
    assert (np.einsum("ki,ki->k", oriented[:, :2], oriented[:, 2:]) <= 0.0).all()


def test_through_a_noisy_laser_longer_walls_are_straight():
    noise_m, resampler = 0.03, Resampler(ResamplingConfig(), BEAMS)
    ranges = see(room(), (2.0, 2.0, 0.0), 1)
    noisy = ranges + np.random.default_rng(2).normal(0.0, noise_m, len(ranges)).astype(np.float32)
    resampler.points(Scan(0, noisy, BEAMS), STILL)

    def share():
        return (resampler.oriented_means()[:, 2:] != 0.0).any(axis=1).mean()

    assert share() < 0.2
    resampler.noise_m = noise_m
    assert share() > 0.4


def test_without_resampling_no_surface_has_an_end():
    resampler = Resampler(ResamplingConfig(points=0), BEAMS)
    resampler.points(Scan(0, see(room(), (2.0, 2.0, 0.0), 1), BEAMS), STILL)
    assert (resampler.spans_m(len(resampler.means())) == np.inf).all()
    assert Resampler(ResamplingConfig(), BEAMS).spans_m(0).shape == (0,)


def line_angle(points):
    off = points - points.mean(axis=0)
    xx, xy, yy = (off[:, 0] ** 2).sum(), (off[:, 0] * off[:, 1]).sum(), (off[:, 1] ** 2).sum()
    return 0.5 * np.arctan2(2.0 * xy, xx - yy)


@pytest.mark.parametrize("angle_deg", [0.0, 10.0, -25.0, 77.0])
def test_a_noisy_wall_is_not_turned(angle_deg):
    angle = np.radians(angle_deg)
    errors, shifts = [], []
    for seed in range(200):
        points, means = resampled(wall_ranges(1.0, angle, np.radians(60), noise_m=0.02, seed=seed))
        turned = line_angle(means) - (angle + np.pi / 2)
        errors.append((turned + np.pi / 2) % np.pi - np.pi / 2)
        shifts.append((means.mean(axis=0) - points.mean(axis=0)) @ (np.cos(angle), np.sin(angle)))
    # One wall errs by 0.05 deg, so that the mean of 200 is known to 0.004.
    assert abs(np.degrees(np.mean(errors))) < 0.015
    assert np.degrees(np.std(errors)) < 0.08
    assert abs(np.mean(shifts)) < 5e-4


@pytest.mark.parametrize("count", [0, 1, 2, 3, 5, 9, 11, 200])
def test_any_number_of_valid_rays_works(count):
    ranges = np.full(682, np.nan)
    where = np.random.default_rng(count).permutation(682)[:count]
    ranges[where] = 1.5
    points, means = resampled(ranges)
    assert len(points) == count
    assert min(count, 1) <= len(means) <= count
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.5, rtol=1e-6)
    beside = np.concatenate((np.full(300, np.nan), np.full(count, 1.5), np.full(382 - count, np.nan)))
    points, means = resampled(beside)
    assert len(points) == count
    assert min(count, 1) <= len(means) <= count


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"points": 9}, "points = 9"),
        ({"max_slant": 0.0}, "max_slant = 0.0"),
        ({"range_noise_m": -0.1}, "range_noise_m"),
        ({"bend_support_m": float("nan")}, "bend_support_m"),
        ({"bend_weight": -1.0}, "bend_weight"),
        ({"short_weight": -1.0}, "short_weight"),
        ({"short_m": 0.0}, "short_m"),
    ],
)
def test_a_resampling_that_cannot_be_is_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        ResamplingConfig(**wrong)
