"""A known motion is found again, the prior holds where the scan says nothing, and a polish never harms."""

import dataclasses
import itertools

import numpy as np
import pytest

from processing.evolution import EvolutionConfig, maximise, random_state
from processing.matching import MOST_REACH_M, REACH_SIGMAS, Matcher, MatchingConfig
from processing.matching_kernels import search
from processing.ndt import Ndt, NdtConfig
from processing.prediction import Prior, turned
from processing.se2 import between, compose, invert, transform

WIDE = MatchingConfig(
    search=EvolutionConfig(population=60, generations=60), window_m=0.45, window_rad=0.5, freedom=4.0
)
LOOSE = np.diag((1 / 0.3**2, 1 / 0.3**2, 1 / 0.35**2))
CORNERS = ((-2.0, -1.5), (2.6, -1.5), (2.6, 1.8), (0.9, 1.8), (0.9, 1.2), (-2.0, 1.2), (-2.0, -1.5))


def walls(corners, spacing_m=0.05):
    parts = []
    for a, b in itertools.pairwise(np.array(corners, float)):
        steps = np.arange(0.5 * spacing_m, np.linalg.norm(b - a), spacing_m)[:, None]
        parts.append(a + steps * (b - a) / np.linalg.norm(b - a))
    return np.concatenate(parts)


# No wall lies on the border of two cells, where a rounding would decide.
ROOM = walls(CORNERS) + np.array((0.03, 0.07))
HALL = walls(((-8.0, -1.0), (8.0, -1.0))), walls(((-8.0, 1.0), (8.0, 1.0)))


def built(points, config=None):
    ndt = Ndt(config or NdtConfig(fine_cell_m=0.0))
    ndt.build(points)
    return ndt


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("ahead_m", [0.03, 0.06, 0.12])
def test_a_corner_beside_the_laser_does_not_hold_it(seed, ahead_m):
    """Rays that leave it sideways hit the wall beside it wherever it is: for a while in the corner's cell."""
    rng = np.random.default_rng(seed)
    along = np.arange(0.0, 6.0, 0.08)
    sides = np.vstack([np.column_stack((along, np.full(len(along), y))) for y in (0.6, -1.5)])
    jamb = np.column_stack((np.zeros(8), np.linspace(0.6, 0.9, 8)))
    before = np.tile(np.vstack((sides, jamb)), (6, 1))
    reference = built(before + rng.normal(0.0, 0.01, before.shape), NdtConfig())
    points = sides + rng.normal(0.0, 0.01, sides.shape)
    normals = np.column_stack((np.zeros(len(sides)), -np.sign(sides[:, 1])))
    prior = Prior(np.array((ahead_m, 0.0, 0.0)), np.eye(3) / 0.05**2)

    def match(seen):
        return Matcher(MatchingConfig(), seed).match(seen, reference, prior)

    plain, oriented = match(points), match(np.hstack((points, normals)))
    assert plain.information[0, 0] > 1.0 / 0.075**2
    assert oriented.information[0, 0] < 1.0 / 0.09**2
    assert oriented.pose[0] == pytest.approx(ahead_m, abs=0.006)
    # Across, and in its rotation, it is known as well.
    for axis in (1, 2):
        assert oriented.information[axis, axis] > 0.9 * plain.information[axis, axis]


def starts():
    """Errors of the guess: up to 0.3 m and 20 degrees off, all around."""
    for k, off in enumerate(np.linspace(0.0, 2.0 * np.pi, 8, endpoint=False)):
        yield np.array((0.3 * np.cos(off), 0.3 * np.sin(off), np.radians(20.0) * (-1) ** k))


@pytest.mark.parametrize("error", list(starts()))
def test_a_known_motion_in_a_room_is_found_again(error):
    truth = np.array((0.4, -0.2, 0.6))
    points = transform(invert(truth), ROOM)
    # What the guess claims of itself is weak, so that the scan decides.
    found = Matcher(WIDE, 1).match(points, built(ROOM), Prior(truth + error, 0.01 * LOOSE))
    off = found.pose - truth
    assert np.hypot(off[0], off[1]) < 0.01
    assert abs(np.degrees(off[2])) < 0.1
    assert found.score > 0.6


def test_noise_of_a_cheap_laser_moves_a_match_by_millimetres():
    truth = np.array((0.4, -0.2, 0.6))
    rng = np.random.default_rng(3)
    reference = built(ROOM + rng.normal(0.0, 0.01, ROOM.shape))
    matcher, offs = Matcher(MatchingConfig(), 1), []
    prior = Prior(truth + np.array((0.05, -0.05, 0.04)), 0.01 * LOOSE)
    for _ in range(20):
        points = transform(invert(truth), ROOM + rng.normal(0.0, 0.01, ROOM.shape))
        offs.append(matcher.match(points, reference, prior).pose)
    offs = np.array(offs) - truth
    assert np.abs(offs[:, :2]).max() < 0.01
    assert np.degrees(np.abs(offs[:, 2]).max()) < 0.25


@pytest.mark.parametrize("shift_cells", [(3, -8), (-400, 1000)])
def test_the_answer_moves_with_reference_and_prior(shift_cells):
    # Whole cells and quarter turns leave the cells as they are.
    shift = np.array((0.5 * shift_cells[0], 0.5 * shift_cells[1], np.pi / 2))
    truth = np.array((0.4, -0.2, 0.6))
    points = transform(invert(truth), ROOM)
    guess = truth + np.array((0.1, 0.1, -0.1))
    information = np.array(((30.0, 10.0, 5.0), (10.0, 20.0, -4.0), (5.0, -4.0, 50.0)))
    here = Matcher(WIDE, 1).match(points, built(ROOM), Prior(guess, information))
    moved = Prior(compose(shift, guess), turned(information, shift[2]))
    there = Matcher(WIDE, 1).match(points, built(transform(shift, ROOM)), moved)
    np.testing.assert_allclose(between(compose(shift, here.pose), there.pose), 0.0, atol=1e-4)
    assert there.score == pytest.approx(here.score, abs=1e-4)
    np.testing.assert_allclose(there.information, turned(here.information, shift[2]), rtol=0.01, atol=1.0)


def log_posterior(config, reference, points, prior, pose, trust=1.0):
    off = pose - prior.pose
    score = reference.score(points, pose).value
    return config.score_weight * score - 0.5 * trust * off @ prior.information @ off


@pytest.mark.parametrize("seed", range(10))
def test_a_polish_never_lowers_the_posterior(seed):
    rng = np.random.default_rng(seed)
    truth = rng.uniform((-0.5, -0.5, -1.0), (0.5, 0.5, 1.0))
    points = transform(invert(truth), ROOM + rng.normal(0.0, 0.02, ROOM.shape))
    reference = built(ROOM)
    prior = Prior(truth + rng.normal(0.0, (0.1, 0.1, 0.1)), LOOSE)
    alone = Matcher(dataclasses.replace(WIDE, polish=False), seed).match(points, reference, prior)
    both = Matcher(WIDE, seed).match(points, reference, prior)
    assert alone.polish_steps == 0 < both.polish_steps
    off = alone.pose - prior.pose
    # The weight of Student's t where the search ended.
    trust = (WIDE.freedom + 3.0) / (WIDE.freedom + off @ prior.information @ off)
    before = log_posterior(WIDE, reference, points, prior, alone.pose, trust)
    after = log_posterior(WIDE, reference, points, prior, both.pose, trust)
    assert after >= before - 1e-9
    # And it ends where the posterior has no slope left, but that of the weights, which are held fixed.
    score = reference.score(points, both.pose)
    slope = WIDE.score_weight * score.gradient - trust * prior.information @ (both.pose - prior.pose)
    curvature = trust * prior.information - WIDE.score_weight * score.hessian
    assert np.abs(np.linalg.solve(curvature, slope)).max() < 1e-4


def test_the_compiled_search_takes_the_steps_of_the_plain_one():
    config = EvolutionConfig(population=30, generations=12, spread=(0.0, 0.0, 0.0))
    points, reference = transform(np.array((0.1, 0.05, -0.1)), ROOM), built(ROOM)
    information = np.array(((30.0, 10.0, 5.0), (10.0, 20.0, -4.0), (5.0, -4.0, 50.0)))
    guess, freedom, weight = np.array((0.05, -0.02, 0.03)), 4.0, 0.3
    bounds = np.stack((guess - 0.4, guess + 0.4))

    def posterior(pose):
        off = pose - guess
        student = -0.5 * (freedom + 3.0) * np.log1p(off @ information @ off / freedom)
        return weight * reference.sampled_score(points, pose) + student

    plain = maximise(posterior, bounds, config, random_state(6), guess=guess)
    given = np.array((*guess, *information.ravel(), freedom, weight))
    population, values = np.empty((30, 3)), np.empty(32)
    grid = (reference.origin, reference.slots, reference.tiles)
    rule, state = config.rule(), random_state(6)
    best = search(points, *grid, given, bounds, rule, population, values, state)
    np.testing.assert_allclose(population, plain.population, atol=1e-12)
    assert values[best] == values[:30].max() == pytest.approx(plain.value)
    assert tuple(values[30:]) == (plain.generations, plain.evaluations)


def test_without_a_search_the_polish_alone_mends_a_small_error_only():
    truth = np.array((0.4, -0.2, 0.6))
    points, reference = transform(invert(truth), ROOM), built(ROOM)
    config = dataclasses.replace(WIDE, search=EvolutionConfig(generations=0))
    near_error = np.array((0.03, -0.02, 0.02))
    near = Matcher(config, 1).match(points, reference, Prior(truth + near_error, 0.01 * LOOSE))
    assert (near.generations, near.evaluations) == (0, 0)
    assert np.abs(near.pose - truth).max() < 0.01
    error = np.array((0.3, 0.0, np.radians(20.0)))
    far = Matcher(config, 1).match(points, reference, Prior(truth + error, 0.01 * LOOSE))
    assert np.abs(far.pose - truth).max() > 0.05


@pytest.mark.parametrize("yaw_rad", [0.0, 0.5, np.pi / 2])
def test_in_a_plain_corridor_the_prior_holds_along_and_the_scan_across(yaw_rad):
    # Endless for the scan: its points end long before the reference does.
    turn = np.array((0.0, 0.0, yaw_rad))
    whole = np.concatenate(HALL)
    reference = built(transform(turn, whole))
    points = whole[np.abs(whole[:, 0]) < 3.0]
    prior = Prior(
        compose(turn, np.array((0.1, 0.08, 0.03))), turned(np.diag((2500.0, 400.0, 400.0)), yaw_rad)
    )
    found = between(turn, Matcher(MatchingConfig(), 1).match(points, reference, prior).pose)
    assert found[0] == pytest.approx(0.1, abs=0.02)
    assert found[1] == pytest.approx(0.0, abs=0.005)
    assert abs(found[2]) < np.radians(0.2)


def test_an_even_rectangle_fits_as_well_turned_by_half():
    rectangle = walls(((-2.0, -1.5), (2.0, -1.5), (2.0, 1.5), (-2.0, 1.5), (-2.0, -1.5)))
    reference = built(rectangle)
    here, turned_half = (reference.score(rectangle, np.array((0.0, 0.0, yaw))) for yaw in (0.0, np.pi))
    assert turned_half.value == pytest.approx(here.value, rel=1e-9)
    quarter = reference.score(rectangle, np.array((0.0, 0.0, np.pi / 2)))
    assert quarter.value < 0.5 * here.value
    # So the prior alone decides between the two.
    for yaw in (0.1, np.pi - 0.1):
        found = Matcher(WIDE, 1).match(rectangle, reference, Prior(np.array((0.05, 0.0, yaw)), LOOSE))
        np.testing.assert_allclose(found.pose[:2], 0.0, atol=0.01)
        assert np.cos(found.pose[2]) == pytest.approx(np.sign(np.cos(yaw)), abs=1e-4)


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("polished", [True, False])
def test_the_information_is_symmetric_and_never_negative(seed, polished):
    rng = np.random.default_rng(seed)
    config = dataclasses.replace(WIDE, polish=polished)
    for points in (ROOM, HALL[0], rng.uniform(-2.0, 2.0, (60, 2)), ROOM[:1]):
        found = Matcher(config, seed).match(points, built(ROOM), Prior(rng.normal(0.0, 0.1, 3), LOOSE))
        np.testing.assert_array_equal(found.information, found.information.T)
        np.testing.assert_array_equal(found.hessian, found.hessian.T)
        values = np.linalg.eigvalsh(found.information)
        assert values.min() >= -1e-9 * max(values.max(), 1.0)


def test_information_counts_the_points_and_their_weight():
    reference = built(ROOM)
    prior = Prior(np.zeros(3), 1e9 * np.eye(3))
    one = Matcher(MatchingConfig(), 1).match(ROOM, reference, prior)
    twice = Matcher(MatchingConfig(), 1).match(np.concatenate((ROOM, ROOM)), reference, prior)
    double = 2.0 * MatchingConfig().score_weight
    heavy = Matcher(MatchingConfig(score_weight=double), 1).match(ROOM, reference, prior)
    np.testing.assert_allclose(twice.information, 2.0 * one.information, rtol=1e-3, atol=1.0)
    np.testing.assert_allclose(heavy.information, 2.0 * one.information, rtol=1e-3, atol=1.0)
    assert twice.score == pytest.approx(one.score, abs=1e-4) == pytest.approx(heavy.score, abs=1e-4)


@pytest.mark.parametrize("fine_cell_m", [0.0, 0.25])
@pytest.mark.parametrize("polished", [True, False])
def test_the_information_of_all_points_is_that_of_the_match_and_parts_add_up(fine_cell_m, polished):
    reference = built(ROOM, NdtConfig(fine_cell_m=fine_cell_m))
    matcher = Matcher(MatchingConfig(polish=polished), 1)
    found = matcher.match(ROOM, reference, Prior(np.array((0.02, 0.01, 0.01)), LOOSE))
    whole = matcher.information(ROOM, reference, found.pose)
    np.testing.assert_allclose(whole, found.information, rtol=1e-6, atol=1e-3)
    parts = [matcher.information(part, reference, found.pose) for part in (ROOM[::3], ROOM[1::3], ROOM[2::3])]
    np.testing.assert_allclose(sum(parts), whole, rtol=1e-9, atol=1e-6)
    assert not matcher.information(ROOM[:0], reference, found.pose).any()


def test_what_is_told_was_seen_when_the_points_were_that_tell_it():
    matcher, reference = Matcher(MatchingConfig(), 1), built(ROOM)
    found = matcher.match(ROOM, reference, Prior(np.zeros(3), LOOSE))
    points = np.hstack((ROOM, np.zeros_like(ROOM)))
    seen_s = np.linspace(-0.1, 0.1, len(points))
    told_s = matcher.telling_s(points, seen_s, reference, found)
    # Of how a twist has moved each point when it was seen, the match sees the mean by information.
    each = [matcher.information(point[None], reference, found.pose) for point in points]
    exact = np.linalg.solve(sum(each), np.einsum("i,ijk->jk", seen_s, each))
    np.testing.assert_allclose(told_s, exact, atol=0.004)
    assert np.abs(exact).max() > 0.02
    still = matcher.telling_s(points, np.full(len(points), 0.07), reference, found)
    np.testing.assert_allclose(still, 0.07 * np.eye(3), atol=1e-6)
    assert not matcher.telling_s(points[:0], seen_s[:0], reference, found).any()


def test_who_may_be_far_from_the_prior_is_searched_as_far_but_not_without_end():
    matcher = Matcher(MatchingConfig(), 1)

    def diagonal(x_m, y_m):
        return Prior(np.zeros(3), np.diag((x_m**-2, y_m**-2, 1e4)))

    usual = (matcher.config.window_m, matcher.config.window_m, matcher.config.window_rad)
    np.testing.assert_allclose(matcher.reach(diagonal(0.05, 0.1)), usual)
    np.testing.assert_allclose(matcher.reach(diagonal(0.2, 0.01)), (REACH_SIGMAS * 0.2, *usual[1:]))
    np.testing.assert_allclose(matcher.reach(diagonal(0.01, 5.0)), (usual[0], MOST_REACH_M, usual[2]))


def test_nothing_to_match_leaves_the_pose_where_the_prior_says():
    prior = Prior(np.array((0.3, -0.2, 1.0)), LOOSE)
    for points, reference in ((np.empty((0, 2)), built(ROOM)), (ROOM, built(np.empty((0, 2))))):
        found = Matcher(MatchingConfig(), 1).match(points, reference, prior)
        np.testing.assert_allclose(found.pose, prior.pose, atol=0.01)
        assert found.score == 0.0
        assert not found.information.any()


def test_the_given_window_is_not_left_by_the_search():
    truth = np.array((0.4, 0.0, 0.0))
    config = dataclasses.replace(WIDE, polish=False)
    points, reference = transform(invert(truth), ROOM), built(ROOM)
    prior = Prior(np.zeros(3), 1e-3 * LOOSE)
    small = Matcher(config, 1).match(points, reference, prior, np.array((0.1, 0.05, 0.02)))
    assert np.all(np.abs(small.pose) <= (0.1, 0.05, 0.02))
    large = Matcher(config, 1).match(points, reference, prior, np.array((0.5, 0.2, 0.2)))
    assert np.abs(large.pose - truth).max() < 0.03


def test_the_same_seed_matches_the_same_and_goes_on_from_match_to_match():
    points, reference, prior = (
        transform(np.array((0.1, 0.0, 0.1)), ROOM),
        built(ROOM),
        Prior(np.zeros(3), LOOSE),
    )
    config = dataclasses.replace(WIDE, polish=False)
    first, same, other = (Matcher(config, seed) for seed in (3, 3, 4))
    a, b = (matcher.match(points, reference, prior).pose for matcher in (first, same))
    np.testing.assert_array_equal(a, b)
    assert not np.array_equal(other.match(points, reference, prior).pose, a)
    assert not np.array_equal(first.match(points, reference, prior).pose, a)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"window_m": 0.0}, "window_m = 0.0"),
        ({"window_rad": 3.2}, "window_rad = 3.2"),
        ({"score_weight": 0.0}, "score_weight = 0.0"),
        ({"freedom": 0.0}, "freedom = 0.0"),
        ({"coarse_deviation_m": -0.1}, "coarse_deviation_m = -0.1"),
    ],
)
def test_a_matching_that_cannot_be_is_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        MatchingConfig(**wrong)
