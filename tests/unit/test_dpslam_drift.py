"""What a return takes back of a path's drift: all that came after the place, and nothing that came before."""

import numpy as np
import pytest

from processing.dpslam.drift import Drift
from processing.motion import carried
from processing.se2 import between, compose, invert

STEP = np.diag((0.02**2, 0.01**2, 0.005**2))
MOTION = np.array((0.5, 0.02, 0.07))
KEYS, PLACE = 40, 15


def driven(keys=KEYS):
    """A drift along a bent path (K, 3)."""
    drift, path = Drift(), [np.zeros(3)]
    drift.go_on(STEP, np.zeros(3))
    for _ in range(keys - 1):
        drift.go_on(STEP, MOTION)
        path.append(compose(path[-1], MOTION))
    return drift, np.array(path)


def posterior(path, place, information):
    """Covariances (K, 3, 3), laser frames, when the last key scan was seen from another: all errors at once.

    Errors are unknowns on the axes of the first frame, where motions carry none of them.
    """
    count = len(path)
    whole = np.zeros((3 * count, 3 * count))

    def relate(i, j, known):
        for a, sign_a in ((i, -1.0), (j, 1.0)):
            for b, sign_b in ((i, -1.0), (j, 1.0)):
                whole[3 * a : 3 * a + 3, 3 * b : 3 * b + 3] += sign_a * sign_b * known

    whole[:3, :3] = 1e9 * np.eye(3)
    for k in range(1, count):
        relate(k - 1, k, np.linalg.inv(carried(STEP, invert(path[k]))))
    if information is not None:
        relate(place, count - 1, np.linalg.inv(carried(np.linalg.inv(information), invert(path[-1]))))
    covariance = np.linalg.inv(whole)
    return np.array(
        [carried(covariance[3 * k : 3 * k + 3, 3 * k : 3 * k + 3], path[k]) for k in range(count)]
    )


def test_errors_add_up_along_the_way():
    drift, path = driven()
    np.testing.assert_allclose(drift.errors.rows, posterior(path, PLACE, None), rtol=1e-4, atol=1e-8)


@pytest.mark.parametrize("place", [0, PLACE, KEYS - 2])
def test_a_return_is_what_the_errors_of_all_key_scans_together_say(place):
    drift, path = driven()
    information = np.diag((1e4, 100.0, 2e4))
    drift.find(place, between(path[place], path[-1]), information)
    drift.close(place, path, information)
    expected = posterior(path, place, information)
    np.testing.assert_allclose(drift.now, expected[-1], rtol=1e-3, atol=5e-7)
    np.testing.assert_allclose(drift.errors.rows[1:], expected[1:], rtol=1e-3, atol=5e-7)


def test_who_comes_back_to_the_newest_ground_knows_no_more_of_the_oldest():
    drift, path = driven()
    at_place = carried(drift.errors.rows[PLACE], between(path[PLACE], path[-1]))
    drift.find(PLACE, between(path[PLACE], path[-1]), 1e9 * np.eye(3))
    np.testing.assert_allclose(drift.now, at_place, rtol=1e-3, atol=1e-8)
    assert np.linalg.eigvalsh(drift.since(PLACE, between(path[PLACE], path[-1]))).max() < 1e-6


def test_a_place_that_is_known_worse_than_the_laser_takes_nothing_from_it():
    drift, path = driven()
    drift.find(0, path[-1], 1e9 * np.eye(3))
    before = drift.now
    drift.find(KEYS - 2, between(path[KEYS - 2], path[-1]), 1e6 * np.eye(3))
    np.testing.assert_allclose(drift.now, before, atol=1e-9)


def test_nothing_is_off_before_the_first_key_scan():
    assert (Drift().now == 0.0).all()


def test_a_saved_path_has_the_drift_that_it_had():
    drift, path = driven()
    ends, known = np.array([(0, 20), (PLACE, KEYS - 1)]), np.diag((1e4, 100.0, 2e4))
    poses = np.array([between(path[i], path[j]) for i, j in ends])
    lived = Drift()
    for key in range(KEYS):
        lived.go_on(STEP, MOTION if key else np.zeros(3))
        for (i, j), pose in zip(ends, poses, strict=True):
            if key == j:
                lived.find(i, pose, known)
    # In whatever order its relations were saved.
    retold = Drift.retold(
        drift.steps.rows, np.tile(MOTION, (KEYS, 1)), ends[::-1], poses[::-1], np.stack((known, known))
    )
    np.testing.assert_array_equal(retold.errors.rows, lived.errors.rows)
    assert (np.linalg.det(lived.errors.rows[20:]) < np.linalg.det(drift.errors.rows[20:])).all()
