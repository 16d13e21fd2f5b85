"""The path under its relations: exact where it must be, robust where a relation lies."""

import numpy as np
import pytest

from processing.se2 import between, compose
from processing.smoothing import Relations, smooth


def circle(count):
    """One round of steps of 0.25 m that ends where it began."""
    poses = [np.zeros(3)]
    for _ in range(count):
        poses.append(compose(poses[-1], np.array((0.25, 0.0, 2 * np.pi / count))))
    return np.array(poses)


def relations_of(poses, pairs, noise, bends=0.0, seed=0):
    rng = np.random.default_rng(seed)
    sd = np.broadcast_to(noise, (len(pairs), 3))
    measured = np.array(
        [
            compose(between(poses[i], poses[j]), rng.normal(0, 1, 3) * s)
            for (i, j), s in zip(pairs, sd, strict=True)
        ]
    )
    information = np.array([np.diag(1.0 / np.square(s)) for s in sd])
    return Relations(np.array(pairs), measured, information, np.full(len(pairs), bends))


def chained(relations, count):
    poses = [np.zeros(3)]
    for k in range(count):
        poses.append(compose(poses[-1], relations.i_t_j[k]))
    return np.array(poses)


def test_a_chain_without_loops_stays_as_it_was_measured():
    truth = circle(60)
    relations = relations_of(truth, [(k, k + 1) for k in range(60)], (0.01, 0.01, 0.004))
    start = chained(relations, 60)
    moved = start + np.random.default_rng(1).normal(0, 0.02, start.shape) * (np.arange(61) > 0)[:, None]
    np.testing.assert_allclose(smooth(moved, relations, 20).poses[:, :2], start[:, :2], atol=1e-4)


def test_a_closed_loop_takes_the_drift_out():
    truth = circle(400)
    pairs = [(k, k + 1) for k in range(400)] + [(400, 0)]
    noise = np.vstack((np.tile((0.01, 0.01, 0.004), (400, 1)), (0.005, 0.005, 0.002)))
    relations = relations_of(truth, pairs, noise)
    start = chained(relations, 400)
    assert np.linalg.norm(start[400, :2]) > 0.5
    smoothed = smooth(start, relations)
    assert np.linalg.norm(smoothed.poses[400, :2] - truth[400, :2]) < 0.03
    off = np.linalg.norm(smoothed.poses[:, :2] - truth[:, :2], axis=1)
    assert off.max() < np.linalg.norm(start[:, :2] - truth[:, :2], axis=1).max() / 2


def test_the_solution_equals_a_dense_one():
    truth = circle(30)
    pairs = [(k, k + 1) for k in range(30)] + [(30, 0), (3, 22), (25, 7)]
    relations = relations_of(truth, pairs, (0.02, 0.02, 0.01), seed=3)
    found = smooth(chained(relations, 30), relations, 30)

    def errors(flat):
        poses = np.vstack((truth[:1], flat.reshape(-1, 3)))
        rows = []
        for (i, j), z, information in zip(pairs, relations.i_t_j, relations.information, strict=True):
            rows.append(np.sqrt(np.diag(information)) * between(z, between(poses[i], poses[j])))
        return np.concatenate(rows)

    at = found.poses[1:].ravel().copy()
    for _ in range(30):
        jacobian = np.empty((3 * len(pairs), at.size))
        for n in range(at.size):
            nudge = np.zeros(at.size)
            nudge[n] = 1e-6
            jacobian[:, n] = (errors(at + nudge) - errors(at - nudge)) / 2e-6
        at = at - np.linalg.lstsq(jacobian, errors(at), rcond=None)[0]
    np.testing.assert_allclose(found.poses[1:].ravel(), at, atol=2e-4)


def test_a_relation_that_lies_is_doubted():
    truth = circle(100)
    pairs = [(k, k + 1) for k in range(100)]
    honest = relations_of(truth, [*pairs, (100, 0)], (0.005, 0.005, 0.002))
    lie = np.array((1.5, -0.8, 0.6))
    bends = np.concatenate((np.zeros(101), (12.0,)))
    relations = Relations(
        np.vstack((honest.ends, (20, 70))),
        np.vstack((honest.i_t_j, lie)),
        np.concatenate((honest.information, np.diag((4e4, 4e4, 2.5e5))[None])),
        bends,
    )
    smoothed = smooth(chained(honest, 100), relations, 20)
    assert smoothed.chi2[-1] > 1000.0
    assert np.linalg.norm(smoothed.poses[50, :2] - truth[50, :2]) < 0.1


@pytest.mark.parametrize("first", [(0.0, 0.0, 0.0), (4.0, -2.0, 2.5)])
def test_the_first_pose_is_held(first):
    truth = compose(np.tile(np.array(first), (41, 1)), circle(40))
    relations = relations_of(truth, [(k, k + 1) for k in range(40)] + [(40, 0)], (0.01, 0.01, 0.004))
    np.testing.assert_array_equal(smooth(truth, relations).poses[0], truth[0])
