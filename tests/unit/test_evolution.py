"""Differential evolution finds known optima, ends by its rules, and stays in its box."""

import dataclasses
from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from processing.evolution import TABLE_1, EvolutionConfig, maximise, random_state
from processing.evolution_kernels import gathered, propose, scatter, uniform
from tests.unit import naive_odometry as naive

FLAT = EvolutionConfig(spread=(0.0, 0.0))
FIRST = (0.3, -0.2, 0.1)


def box(half, dimensions):
    return np.array((np.full(dimensions, -half), np.full(dimensions, half)), np.float64)


def sphere(place):
    return -float(np.sum(np.square(place - FIRST)))


def rosenbrock(place):
    ahead, behind = place[1:], place[:-1]
    return -float(np.sum(100.0 * (ahead - behind**2) ** 2 + (1.0 - behind) ** 2))


def rastrigin(place):
    off = place - 1.1
    return -float(np.sum(off**2 + 2.0 * (1.0 - np.cos(2.0 * np.pi * off))))


def climb(objective, place, step=0.01):
    """Go to the better neighbour until there is none."""
    moves = [s * step * np.eye(len(place))[d] for d in range(len(place)) for s in (1, -1)]
    while objective(best := max((place + move for move in moves), key=objective)) > objective(place):
        place = best
    return place


def test_table_1_has_the_values_of_the_paper():
    assert (TABLE_1.population, TABLE_1.generations) == (100, 50)
    assert (TABLE_1.factor, TABLE_1.crossover) == (1.0, 0.95)


@pytest.mark.parametrize("seed", range(5))
def test_table_1_finds_the_middle_of_a_sphere_in_a_window_of_matching(seed):
    found = maximise(sphere, box(0.5, 3), TABLE_1, random_state(seed))
    assert np.abs(found.place - FIRST).max() < 0.02
    assert found.value == sphere(found.place)


@pytest.mark.parametrize("dimensions", [2, 3])
@pytest.mark.parametrize("seed", range(3))
def test_the_bent_valley_of_rosenbrock_is_followed_to_its_end(dimensions, seed):
    config = dataclasses.replace(
        TABLE_1, population=40, factor=0.7, generations=250, spread=(0.0,) * dimensions
    )
    found = maximise(rosenbrock, box(2.0, dimensions), config, random_state(seed))
    assert np.abs(found.place - 1.0).max() < 0.01


@pytest.mark.parametrize("seed", range(5))
def test_the_best_of_many_tops_is_found_where_climbing_from_the_start_fails(seed):
    start = np.array((-2.0, 2.9))
    assert rastrigin(climb(rastrigin, start)) < -5.0
    config = dataclasses.replace(TABLE_1, factor=0.7, spread=(0.0, 0.0))
    found = maximise(rastrigin, box(4.0, 2), config, random_state(seed), guess=start)
    assert np.abs(found.place - 1.1).max() < 0.02


def test_the_search_ends_when_a_member_is_good_enough():
    config = dataclasses.replace(TABLE_1, enough=-0.01, spread=(0.0,) * 3)
    found = maximise(sphere, box(0.5, 3), config, random_state(1))
    assert found.value >= -0.01
    assert 0 < found.generations < 50
    shorter = dataclasses.replace(config, generations=found.generations - 1)
    assert maximise(sphere, box(0.5, 3), shorter, random_state(1)).value < -0.01


def test_a_good_enough_guess_costs_no_generation():
    config = dataclasses.replace(TABLE_1, enough=-1e-6)
    found = maximise(sphere, box(0.5, 3), config, random_state(1), guess=np.array(FIRST))
    assert (found.generations, found.evaluations) == (0, 100)
    np.testing.assert_array_equal(found.place, FIRST)


def test_the_search_ends_when_all_members_lie_together():
    config = dataclasses.replace(TABLE_1, factor=0.5, generations=1000, spread=(0.05, 0.05, 0.03))
    found = maximise(sphere, box(0.5, 3), config, random_state(1))
    assert found.generations < 1000
    assert np.all(np.ptp(found.population, axis=0) <= config.spread)
    shorter = dataclasses.replace(config, generations=found.generations - 1)
    before = maximise(sphere, box(0.5, 3), shorter, random_state(1)).population
    assert np.any(np.ptp(before, axis=0) > config.spread)


@pytest.mark.parametrize("axis", range(3))
def test_one_axis_that_is_spread_is_not_gathered(axis):
    population = np.zeros((5, 3))
    assert gathered(population, np.zeros(3))
    population[2, axis] = -0.02
    population[4, axis] = 0.02
    spread = np.full(3, 0.04)
    assert gathered(population, spread)
    spread[axis] = 0.039
    assert not gathered(population, spread)


def test_the_search_ends_after_its_generations_and_counts_what_it_tried():
    config = dataclasses.replace(TABLE_1, generations=7, spread=(0.0,) * 3)
    asked = []
    found = maximise(lambda place: asked.append(1) or sphere(place), box(0.5, 3), config, random_state(0))
    assert found.generations == 7
    assert found.evaluations == len(asked) == 100 * 8


def test_the_best_member_never_gets_worse():
    def best_after(generations):
        config = dataclasses.replace(FLAT, generations=generations)
        return maximise(rastrigin, box(4.0, 2), config, random_state(9)).value

    values = [best_after(generations) for generations in range(12)]
    assert values == sorted(values)
    assert values[-1] > values[0]


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**64 - 1), st.floats(0.1, 2.0), st.integers(4, 30), st.integers(1, 4))
def test_no_member_leaves_the_box(seed, factor, size, dimensions):
    # The best place lies outside, in a corner, so that every generation pushes against the walls.
    bounds = box(0.5, dimensions) + np.arange(dimensions)
    config = EvolutionConfig(population=size, generations=15, factor=factor, spread=(0.0,) * dimensions)
    tried = []
    maximise(
        lambda place: tried.append(place.copy()) or float(place.sum()), bounds, config, random_state(seed)
    )
    tried = np.array(tried)
    assert np.all((bounds[0] <= tried) & (tried <= bounds[1]))


@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_member_bounces_back_between_the_wall_and_where_it_came_from(side):
    population = side * np.array(((0.0,), (0.4,), (0.45,), (-0.3,)))
    state, bounds, trial = random_state(3), box(0.5, 1), np.empty(1)
    landed = []
    for _ in range(4000):
        propose(population, 0, bounds, 1.0, 1.0, trial, state)
        landed.append(side * trial[0])
    landed = np.array(landed)
    # 0.4 + 0.75 and 0.45 + 0.7 fall beyond the wall, from bases at 0.4 and 0.45: a third of all.
    beyond = landed[landed >= 0.4]
    assert len(beyond) == pytest.approx(4000 / 3, rel=0.1)
    assert 0.499 < beyond.max() < 0.5
    assert beyond.mean() == pytest.approx(0.5 * (0.45 + 0.475), abs=0.003)


def test_the_donors_differ_from_the_member_and_from_each_other_and_all_are_as_likely():
    # Powers of 5 tell from a + 2 b - 2 c which three were mixed.
    population = 5.0 ** np.arange(5)[:, None]
    codes = {
        5.0**a + 2.0 * 5.0**b - 2.0 * 5.0**c: (a, b, c)
        for a in range(5)
        for b in range(5)
        for c in range(5)
        if len({a, b, c, 2}) == 4
    }
    assert len(codes) == 24
    state, trial = random_state(5), np.empty(1)
    seen = Counter()
    for _ in range(24_000):
        propose(population, 2, box(1e9, 1), 2.0, 0.0, trial, state)
        seen[codes[trial[0]]] += 1
    assert len(seen) == 24
    # Six standard deviations of a count of 1000.
    assert all(abs(count - 1000) < 190 for count in seen.values())


@pytest.mark.parametrize("crossover", [0.0, 0.3, 0.95, 1.0])
def test_each_axis_comes_from_the_mutant_by_chance_and_one_always(crossover):
    population = np.random.default_rng(0).normal(size=(10, 4))
    state, trial, changed = random_state(5), np.empty(4), []
    for _ in range(5000):
        propose(population, 3, box(1e9, 4), 0.7, crossover, trial, state)
        changed.append(trial != population[3])
    assert np.all(np.sum(changed, axis=1) >= 1)
    assert np.mean(changed) == pytest.approx(crossover + (1.0 - crossover) / 4, abs=0.02)


def test_the_start_has_one_member_in_each_slice_of_each_axis():
    bounds = np.array(((-1.0, 2.0, 0.0), (1.0, 3.0, 0.5)))
    population = np.empty((40, 3))
    scatter(population, bounds, random_state(8))
    slices = np.floor((population - bounds[0]) / (bounds[1] - bounds[0]) * 40)
    for column in slices.T:
        np.testing.assert_array_equal(np.sort(column), np.arange(40))
    # Orders of their own: slices of two axes do not go together.
    assert np.abs(np.corrcoef(slices.T) - np.eye(3)).max() < 0.5


def test_the_random_numbers_are_those_of_splitmix64():
    state = random_state(1234567)
    published = (6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431)
    assert [uniform(state) for _ in range(4)] == [(number >> 11) / 2**53 for number in published]


@pytest.mark.parametrize("seed", [0, 7, 2**64 - 1])
def test_every_member_is_that_of_the_plain_twin(seed):
    config = EvolutionConfig(population=12, generations=20, factor=0.9, crossover=0.7, spread=(0.0,) * 3)
    found = maximise(sphere, box(0.5, 3), config, random_state(seed))
    members, values = naive.evolve(sphere, box(0.5, 3), config, seed)
    np.testing.assert_array_equal(found.population, members)
    assert found.value == values.max()


def test_the_same_seed_gives_the_same_members_and_another_seed_others():
    first, same, other = (
        maximise(sphere, box(0.5, 3), TABLE_1, random_state(seed)).population for seed in (4, 4, 5)
    )
    np.testing.assert_array_equal(first, same)
    assert not np.any(first == other)


def test_the_random_numbers_go_on_from_search_to_search():
    state = random_state(4)
    first = maximise(sphere, box(0.5, 3), TABLE_1, state)
    second = maximise(sphere, box(0.5, 3), TABLE_1, state)
    assert not np.any(first.population == second.population)


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"population": 3}, "population = 3"),
        ({"generations": -1}, "generations = -1"),
        ({"factor": 0.0}, "factor = 0.0"),
        ({"crossover": 1.1}, "crossover = 1.1"),
        ({"enough": float("nan")}, "enough = nan"),
        ({"spread": (0.1, -0.1, 0.1)}, "spread"),
    ],
)
def test_a_search_that_cannot_be_is_refused(wrong, said):
    with pytest.raises(ValueError, match=said):
        EvolutionConfig(**wrong)


def test_a_box_turned_inside_out_or_of_other_axes_is_refused():
    with pytest.raises(ValueError, match="lower <= upper"):
        maximise(sphere, box(-0.5, 3), TABLE_1, random_state(0))
    with pytest.raises(ValueError, match="spread has 3 axes, must have 2"):
        maximise(sphere, box(0.5, 2), TABLE_1, random_state(0))
    with pytest.raises(ValueError, match="seed = -1"):
        random_state(-1)
