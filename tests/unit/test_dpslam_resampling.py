"""Weights and selection, against brute force and against chance."""

import numpy as np
import pytest

from processing.dpslam.resampling import effective_size, normalise, sparing, systematic_parents


def test_weights_sum_to_one_whatever_their_offset():
    for offset in (0.0, -1e4, 700.0):
        weights = np.exp(normalise(np.log((1.0, 2.0, 5.0)) + offset))
        assert weights == pytest.approx((0.125, 0.25, 0.625))


def test_a_particle_without_weight_stays_without():
    assert np.exp(normalise(np.array((0.0, -1e300)))).tolist() == [1.0, 0.0]


def test_the_effective_size_counts_who_shares_the_weight():
    assert effective_size(np.zeros(40)) == pytest.approx(40.0)
    assert effective_size(np.array((0.0, -1e300, -1e300))) == pytest.approx(1.0)
    assert effective_size(np.log((0.5, 0.25, 0.25))) == pytest.approx(1 / (0.25 + 0.0625 + 0.0625))


def test_survivors_keep_their_places_and_the_dead_are_replaced():
    rng = np.random.default_rng(0)
    for _ in range(200):
        parents = systematic_parents(3.0 * rng.normal(size=30), rng.random())
        assert np.array_equal(parents[parents], parents)


def test_each_particle_gets_floor_or_ceiling_of_its_share():
    rng = np.random.default_rng(1)
    for _ in range(200):
        log_weights = 2.0 * rng.normal(size=25)
        share = 25 * np.exp(normalise(log_weights))
        children = np.bincount(systematic_parents(log_weights, rng.random()), minlength=25)
        assert (children >= np.floor(share - 1e-9)).all()
        assert (children <= np.ceil(share + 1e-9)).all()


def test_descendants_are_in_the_mean_what_the_weights_ask_for():
    """Chi-square over 4 000 selections: systematic resampling is unbiased."""
    rng = np.random.default_rng(2)
    weights = np.array((0.02, 0.03, 0.05, 0.1, 0.13, 0.17, 0.22, 0.28))
    counts = np.stack(
        [np.bincount(systematic_parents(np.log(weights), u), minlength=8) for u in rng.random(4000)]
    )
    error = counts.mean(axis=0) - 8 * weights
    spread = counts.std(axis=0) / np.sqrt(4000)
    assert (np.abs(error) < 4.0 * np.maximum(spread, 1e-9)).all()


@pytest.mark.parametrize("u", [0.0, 0.5, 1.0 - 2.0**-53])
def test_the_borders_of_the_random_number_draw_nobody_who_has_no_weight(u):
    assert systematic_parents(np.array((-1e300, 0.0, -1e300)), u).tolist() == [1, 1, 1]
    parents = systematic_parents(np.log(np.full(7, 1 / 7)), u)
    assert set(parents.tolist()) <= set(range(7))
    assert len(set(parents.tolist())) >= 6


def test_one_that_was_not_drawn_lives_on_under_its_own_weight():
    weights = np.array((0.02, 0.5, 0.3, 0.18))
    parents = systematic_parents(np.log(weights), 0.3)
    assert parents[0] != 0
    spared, after = sparing(parents, np.log(weights), 0)
    assert spared[0] == 0
    assert np.array_equal(spared[1:], parents[1:])
    assert np.array_equal(spared[spared], spared)
    assert np.exp(after) == pytest.approx((0.02, 0.98 / 3, 0.98 / 3, 0.98 / 3))


def test_one_that_was_drawn_needs_nothing():
    log_weights = np.log((0.1, 0.5, 0.3, 0.1))
    parents = systematic_parents(log_weights, 0.3)
    spared, after = sparing(parents, log_weights, 1)
    assert np.array_equal(spared, parents)
    assert np.exp(after) == pytest.approx(0.25)


def test_one_without_weight_is_spared_and_stays_without():
    spared, after = sparing(np.array((1, 1, 1), dtype=np.int32), np.array((-1e300, 0.0, -1e300)), 0)
    assert spared.tolist() == [0, 1, 1]
    assert np.exp(after) == pytest.approx((0.0, 0.5, 0.5))
