"""The filter of a constant velocity: its geometry, its steadiness, and what it does when nothing is seen."""

import numpy as np
import pytest

from processing.prediction import (
    ConstantVelocity,
    PredictionConfig,
    Prior,
    adjoint,
    exponential,
    logarithm,
    turned,
    weakened,
)
from processing.se2 import between, compose, invert

PERIOD_S = 0.1
TWISTS = np.random.default_rng(0).uniform((-2.0, -2.0, -3.0), (2.0, 2.0, 3.0), (50, 3))
SHARP = np.diag((1e8, 1e8, 1e8))


@pytest.mark.parametrize("turn_rate", [None, 0.0, 1e-12, -1e-7, 1e-3])
def test_exponential_and_logarithm_undo_each_other(turn_rate):
    for twist in TWISTS.copy():
        if turn_rate is not None:
            twist[2] = turn_rate
        np.testing.assert_allclose(logarithm(exponential(twist)), twist, atol=1e-9)
        np.testing.assert_allclose(exponential(logarithm(twist)), twist, atol=1e-9)


def test_the_exponential_is_the_sum_of_many_small_steps():
    for twist in TWISTS[:5]:
        pose = np.zeros(3)
        for _ in range(2000):
            pose = compose(pose, twist / 2000)
        np.testing.assert_allclose(exponential(twist), pose, atol=5e-3)
        half = exponential(0.5 * twist)
        np.testing.assert_allclose(compose(half, half), exponential(twist), atol=1e-12)


def test_the_adjoint_carries_a_small_motion_of_one_frame_into_the_other():
    for a_t_b in TWISTS[:10]:
        columns = []
        for axis in np.eye(3):
            ahead, behind = (compose(compose(a_t_b, step * axis), invert(a_t_b)) for step in (1e-6, -1e-6))
            columns.append((ahead - behind) / 2e-6)
        np.testing.assert_allclose(adjoint(a_t_b), np.transpose(columns), atol=1e-8)


def test_a_turned_information_is_that_of_turned_errors():
    rng = np.random.default_rng(1)
    root = rng.normal(size=(3, 3))
    information, yaw_rad = root @ root.T, 0.7
    for error in rng.normal(size=(5, 3)):
        seen = compose(np.array((0.0, 0.0, yaw_rad)), np.array((*error[:2], 0.0)))
        seen[2] = error[2]
        assert seen @ turned(information, yaw_rad) @ seen == pytest.approx(error @ information @ error)


@pytest.mark.parametrize("twist", [(0.5, 0.0, 0.0), (0.3, 0.0, 0.8), (-0.2, 0.1, -1.5)])
def test_a_constant_velocity_is_followed_exactly(twist):
    twist = np.array(twist)
    filter_ = ConstantVelocity(PredictionConfig())
    truth = np.zeros(3)
    for _ in range(40):
        truth = compose(truth, exponential(twist * PERIOD_S))
        prior = filter_.advance(PERIOD_S)
        innovation = filter_.correct(truth, SHARP)
    np.testing.assert_allclose(filter_.twist, twist, atol=1e-6)
    np.testing.assert_allclose(innovation, 0.0, atol=1e-7)
    np.testing.assert_allclose(between(prior.pose, truth), 0.0, atol=1e-7)
    np.testing.assert_array_equal(filter_.pose, truth)


def moving_filter():
    filter_ = ConstantVelocity(PredictionConfig())
    for k in range(1, 20):
        filter_.advance(PERIOD_S)
        filter_.correct(np.array((0.05 * k, 0.0, 0.02 * k)), np.diag((1e4, 2e4, 1e5)))
    return filter_


def test_a_scan_that_says_nothing_leaves_what_was_expected():
    filter_ = moving_filter()
    prior = filter_.advance(PERIOD_S)
    twist, covariance = filter_.twist.copy(), filter_.covariance.copy()
    assert np.abs(twist).max() > 0.1
    filter_.correct(prior.pose, np.zeros((3, 3)))
    np.testing.assert_array_equal(filter_.pose, prior.pose)
    np.testing.assert_allclose(filter_.twist, twist, atol=1e-12)
    np.testing.assert_allclose(filter_.covariance, covariance, rtol=1e-9, atol=1e-15)


def test_a_correction_is_that_of_a_kalman_filter():
    filter_ = moving_filter()
    prior = filter_.advance(PERIOD_S)
    before, information = filter_.covariance.copy(), np.diag((1e3, 2e3, 1e4))
    twist = filter_.twist.copy()
    innovation = np.array((0.02, -0.01, 0.005))
    posterior = np.linalg.inv(np.linalg.inv(before[:3, :3]) + information)
    told = filter_.correct(compose(prior.pose, exponential(innovation)), information)
    np.testing.assert_allclose(told, innovation, atol=1e-12)
    # All six together: the information of the scan is added to that of the state.
    whole = np.linalg.inv(before)
    whole[:3, :3] += information
    np.testing.assert_allclose(filter_.covariance, np.linalg.inv(whole), rtol=1e-5, atol=1e-12)
    np.testing.assert_allclose(filter_.covariance[:3, :3], posterior, rtol=1e-6, atol=1e-12)
    expected = twist + before[3:, :3] @ np.linalg.solve(before[:3, :3], innovation)
    np.testing.assert_allclose(filter_.twist, expected, rtol=1e-9)


def test_what_was_seen_at_the_end_of_a_sweep_is_a_correction_of_a_kalman_filter_of_pose_and_twist():
    filter_ = moving_filter()
    prior = filter_.advance(PERIOD_S)
    pose, twist, before = filter_.pose.copy(), filter_.twist.copy(), filter_.covariance.copy()
    information = np.array(((1e3, 2e2, 0.0), (2e2, 2e3, 1e2), (0.0, 1e2, 1e4)))
    telling_s = np.array(((0.05, 0.01, 0.0), (0.0, -0.03, 0.002), (0.0, 0.01, 0.02)))
    measured = np.array((0.02, -0.01, 0.005))
    expected = np.linalg.inv(before[:3, :3])
    found = np.linalg.solve(expected + information, information @ measured)
    filter_.correct(compose(prior.pose, exponential(found)), information, telling_s)
    look = np.hstack((np.eye(3), telling_s))
    whole = np.linalg.inv(before) + look.T @ information @ look
    np.testing.assert_allclose(filter_.covariance, np.linalg.inv(whole), rtol=1e-5, atol=1e-12)
    change = np.linalg.solve(whole, look.T @ information @ measured)
    np.testing.assert_allclose(filter_.twist - twist, change[3:], rtol=1e-6, atol=1e-10)
    np.testing.assert_allclose(logarithm(between(pose, filter_.pose)), change[:3], rtol=1e-6, atol=1e-10)


def test_what_was_seen_in_one_instant_tells_the_same_either_way():
    one, other = moving_filter(), moving_filter()
    found = compose(one.advance(PERIOD_S).pose, np.array((0.02, -0.01, 0.005)))
    other.advance(PERIOD_S)
    one.correct(found, np.diag((1e3, 2e3, 1e4)))
    other.correct(found, np.diag((1e3, 2e3, 1e4)), np.zeros((3, 3)))
    np.testing.assert_allclose(other.pose, one.pose, atol=1e-12)
    np.testing.assert_allclose(other.twist, one.twist, atol=1e-12)
    np.testing.assert_allclose(other.covariance, one.covariance, atol=1e-15)


def test_a_turn_rate_that_was_seen_is_a_correction_of_a_kalman_filter():
    filter_ = moving_filter()
    filter_.advance(PERIOD_S)
    pose, twist, before = filter_.pose.copy(), filter_.twist.copy(), filter_.covariance.copy()
    prior = filter_.see_turn(twist[2] + 0.4, 0.1)
    whole = np.linalg.inv(before)
    whole[5, 5] += 1.0 / 0.1**2
    np.testing.assert_allclose(filter_.covariance, np.linalg.inv(whole), rtol=1e-5, atol=1e-12)
    change = np.linalg.solve(whole, np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.4 / 0.1**2)))
    np.testing.assert_allclose(filter_.twist - twist, change[3:], rtol=1e-6, atol=1e-12)
    np.testing.assert_allclose(logarithm(between(pose, filter_.pose)), change[:3], rtol=1e-6, atol=1e-12)
    np.testing.assert_array_equal(prior.pose, filter_.pose)


@pytest.mark.parametrize("yaw_rad", [0.0, 0.9, -2.5])
def test_a_match_that_may_be_wrong_is_as_wrong_as_it_is_far_from_what_was_expected(yaw_rad):
    pose = np.array((1.0, 2.0, yaw_rad))
    # 0.2 m ahead of where it was expected, to within 0.1 m ahead and 0.05 m aside; all on the laser's axes.
    prior = Prior(compose(pose, np.array((-0.2, 0.0, 0.0))), turned(np.diag((1e2, 4e2, 1e4)), yaw_rad))
    claimed = np.diag((1e4, 1e4, 1e6))
    left = np.linalg.inv(weakened(claimed, prior, pose))
    assert np.diag(left) == pytest.approx(
        (1e-4 + 0.01 + 0.04, 1e-4 + 0.0025, 1e-6 + 1e-4), rel=1e-6, abs=1e-9
    )
    # Less than the motion says of it: it can draw the filter no farther than half way.
    assert np.linalg.eigvalsh(np.diag((1e2, 4e2, 1e4)) - weakened(claimed, prior, pose)).min() > 0.0
    nothing = weakened(np.zeros((3, 3)), prior, pose)
    assert np.isfinite(nothing).all()
    assert np.abs(nothing).max() < 2e-6


def test_the_covariance_grows_while_nothing_is_seen_and_stays_symmetric():
    filter_ = moving_filter()
    doubts = []
    for _ in range(30):
        filter_.advance(PERIOD_S)
        np.testing.assert_allclose(filter_.covariance, filter_.covariance.T, rtol=1e-12)
        assert np.linalg.eigvalsh(filter_.covariance).min() > 0.0
        doubts.append(np.diag(filter_.covariance))
    assert np.all(np.diff(doubts, axis=0)[:, 3:] > 0.0)
    assert np.all(doubts[-1][:3] > doubts[0][:3])


def test_an_error_of_the_pose_is_carried_by_the_motion():
    filter_ = ConstantVelocity(PredictionConfig(acceleration=1e-9, turning=1e-9))
    filter_.twist = np.array((2.0, 0.5, 4.0))
    error = np.array((3e-4, -2e-4, 5e-4))
    filter_.covariance = np.zeros((6, 6))
    filter_.covariance[:3, :3] = np.outer(error, error) + 1e-16 * np.eye(3)
    motion = exponential(0.5 * filter_.twist)
    filter_.advance(0.5)
    carried = logarithm(between(motion, compose(exponential(error), motion)))
    np.testing.assert_allclose(filter_.covariance[:3, :3], np.outer(carried, carried), rtol=0.01, atol=1e-11)


def test_one_long_step_doubts_as_much_as_many_short_ones():
    one, many = ConstantVelocity(PredictionConfig()), ConstantVelocity(PredictionConfig())
    one.advance(0.4)
    for _ in range(8):
        many.advance(0.05)
    np.testing.assert_allclose(one.covariance, many.covariance, rtol=1e-9, atol=1e-15)
    # Of a velocity known at first, and a random walk of it from there.
    assert one.covariance[3, 3] == pytest.approx(0.3**2 + 1.0 * 0.4)
    assert one.covariance[0, 0] == pytest.approx(1e-8 + (0.3 * 0.4) ** 2 + 0.4**3 / 3.0)


@pytest.mark.parametrize("steady", [True, False])
def test_the_doubt_of_the_velocity_is_bound_along_what_is_not_seen_only(steady):
    config = PredictionConfig(speed_m_s=0.3)
    filter_ = ConstantVelocity(config)
    for _ in range(50):
        filter_.advance(PERIOD_S)
    before = filter_.covariance.copy()
    along = np.array((np.cos(0.4), np.sin(0.4)))
    across = np.array((-along[1], along[0]))
    assert along @ before[3:5, 3:5] @ along > 1.0
    filter_.bound(along[None], steady)
    after = filter_.covariance
    assert along @ after[3:5, 3:5] @ along == pytest.approx(config.speed_m_s**2)
    # Who may have set out at any speed may be far off by now.
    assert (along @ after[:2, :2] @ along < 0.9 * (along @ before[:2, :2] @ along)) == steady
    for block in (slice(3, 5), slice(0, 2)):
        assert across @ after[block, block] @ across == pytest.approx(across @ before[block, block] @ across)
    assert after[5, 5] == before[5, 5]
    assert np.linalg.eigvalsh(after).min() > 0.0


def test_a_doubt_within_its_bound_is_left_alone():
    filter_ = moving_filter()
    before = filter_.covariance.copy()
    filter_.bound(np.array(((1.0, 0.0), (0.0, 1.0))), True)
    np.testing.assert_array_equal(filter_.covariance, before)


def test_a_forgotten_velocity_is_rest_with_the_doubt_of_a_start():
    filter_ = moving_filter()
    filter_.forget_velocity()
    fresh = ConstantVelocity(PredictionConfig())
    np.testing.assert_array_equal(filter_.twist, np.zeros(3))
    np.testing.assert_array_equal(filter_.covariance, fresh.covariance)


def test_the_expectation_is_given_on_the_axes_of_the_odometry():
    filter_ = moving_filter()
    filter_.pose = np.array((1.0, 2.0, np.pi / 2))
    filter_.twist = np.zeros(3)
    filter_.covariance = np.diag((1e-2, 1e-4, 1e-4, 1e-9, 1e-9, 1e-9))
    information = filter_.advance(1e-3).information
    # Ahead of the laser, where the doubt is, is y.
    assert information[1, 1] == pytest.approx(1e2, rel=0.01)
    assert information[0, 0] == pytest.approx(1e4, rel=0.01)


@pytest.mark.parametrize("name", ["acceleration", "turning", "speed_m_s", "turn_rate_rad_s"])
@pytest.mark.parametrize("value", [0.0, -1.0, 101.0, float("nan")])
def test_a_filter_that_cannot_be_is_refused(name, value):
    with pytest.raises(ValueError, match=name):
        PredictionConfig(**{name: value})


def test_the_filter_takes_up_a_velocity_along_what_is_not_seen_only():
    filter_ = ConstantVelocity(PredictionConfig())
    filter_.twist = np.array((0.1, 0.2, 0.3))
    filter_.steer(np.array(((0.6, 0.8),)), np.array((1.0, 1.0)))
    along, across = np.array((0.6, 0.8)), np.array((-0.8, 0.6))
    assert along @ filter_.twist[:2] == pytest.approx(along @ (1.0, 1.0))
    assert across @ filter_.twist[:2] == pytest.approx(across @ (0.1, 0.2))
    assert filter_.twist[2] == 0.3
