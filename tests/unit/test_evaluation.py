"""Errors of trajectories, on cases whose answer is known."""

import math

import numpy as np
import pytest

from processing import se2
from processing.evaluation import (
    absolute_errors,
    align,
    nearest_stamps,
    relation_errors,
    relative_errors,
    summarise,
)


def wander(n=200, seed=1):
    rng = np.random.default_rng(seed)
    poses = [np.zeros(3)]
    for _ in range(n - 1):
        poses.append(se2.compose(poses[-1], np.array([0.1, 0.0, rng.normal(0, 0.1)])))
    return np.array(poses)


def test_perfect_relations_have_no_error():
    poses = wander()
    truth = se2.between(poses[:-7], poses[7:])
    errors = relation_errors(poses[:-7], poses[7:], truth)
    assert errors.translation_m.max() < 1e-12
    assert errors.rotation_deg.max() < 1e-9


def test_a_relation_error_is_the_truth_inverted_times_the_estimate():
    """Truth: 1 m ahead. Estimate: 1 m ahead, 0.3 m left, turned by 170 degrees, from a pose anywhere."""
    a = np.array([[5.0, -3.0, 2.0]])
    b = se2.compose(a, np.array([[1.0, 0.3, math.radians(170)]]))
    errors = relation_errors(a, b, np.array([[1.0, 0.0, 0.0]]))
    assert errors.translation_m == pytest.approx([0.3])
    assert errors.rotation_deg == pytest.approx([170.0])


def test_a_translation_error_is_seen_in_the_frame_of_the_truth_and_turning_wraps():
    truth = np.array([[0.0, 0.0, math.radians(179)]])
    estimate = np.array([[0.0, 0.0, math.radians(-179)]])
    assert relation_errors(np.zeros((1, 3)), estimate, truth).rotation_deg == pytest.approx([2.0])


def test_summary_figures_are_those_of_the_population():
    s = summarise(np.array([1.0, 2.0, 3.0, 10.0]))
    assert (s.mean, s.max, s.median) == (4.0, 10.0, 2.5)
    assert s.std == pytest.approx(math.sqrt(12.5))
    assert s.rmse == pytest.approx(math.sqrt(28.5))


def test_no_errors_have_no_summary():
    with pytest.raises(ValueError, match="0 errors"):
        summarise(np.zeros(0))


def test_alignment_takes_any_start_out_of_the_absolute_error():
    reference = wander()
    moved = se2.compose(np.array([3.0, -7.0, 2.5]), reference)
    np.testing.assert_allclose(se2.compose(align(reference, moved), moved), reference, atol=1e-9)
    assert absolute_errors(reference, moved).translation_m.max() < 1e-9


def test_alignment_is_the_best_one():
    rng = np.random.default_rng(3)
    reference = wander()
    noisy = reference + rng.normal(0, 0.05, reference.shape)
    best = align(reference, noisy)
    cost = [
        np.sum((se2.compose(best + d, noisy)[:, :2] - reference[:, :2]) ** 2)
        for d in (np.zeros(3), *np.vstack((np.eye(3), -np.eye(3))) * 1e-3)
    ]
    assert np.argmin(cost) == 0


def test_relative_error_is_drift_over_a_stretch():
    """A scale error of 1 % along a straight way is 1 cm in each metre, at every start."""
    x = np.arange(0, 10, 0.1)
    reference = np.column_stack((x, 0 * x, 0 * x))
    errors = relative_errors(reference, reference * [1.01, 1, 1], 1.0)
    assert len(errors) == 90
    np.testing.assert_allclose(errors.translation_m, 0.01, atol=1.1e-3)  # a stretch ends at a whole step


def test_a_way_shorter_than_the_stretch_gives_no_relative_error():
    assert len(relative_errors(wander(5), wander(5), 10.0)) == 0
    with pytest.raises(ValueError, match=r"distance_m = 0\.0, must be positive"):
        relative_errors(wander(5), wander(5), 0.0)


def test_stamps_are_found_where_they_are_in_whatever_order():
    stamps = np.array([50, 10, 40, 30, 10])
    assert nearest_stamps(stamps, np.array([10, 50, 41, 36, 0, 99]), 1).tolist() == [1, 0, 2, -1, -1, -1]
    assert nearest_stamps(stamps, np.array([36, 0, 99]), 100).tolist() == [2, 1, 0]


def test_large_stamps_lose_no_nanosecond():
    stamps = np.array([976052857337530000, 976052857337530001])
    assert nearest_stamps(stamps, stamps, 0).tolist() == [0, 1]
