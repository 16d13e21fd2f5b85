"""Compiled inner loops of differential evolution DE/rand/1/bin, and its random numbers.

The random state is an array that the caller owns: the same seed gives the same bytes on every machine.
Twins in tests/unit/naive_odometry.py.
"""

import numpy as np
from numba import njit


@njit("f8(u8[::1])", cache=True, nogil=True)
def uniform(state):
    """Return the next number in [0, 1) and move `state` (1,) on (SplitMix64, Steele et al. 2014)."""
    state[0] += np.uint64(0x9E3779B97F4A7C15)
    z = state[0]
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@njit("void(f8[:,::1], f8[:,::1], u8[::1])", cache=True, nogil=True)
def scatter(population, bounds, state):
    """Fill the population (NP, D) over the box `bounds` (2, D), one member in each slice of an axis."""
    size, dimensions = population.shape
    for d in range(dimensions):
        width = (bounds[1, d] - bounds[0, d]) / size
        for i in range(size):
            population[i, d] = bounds[0, d] + (i + uniform(state)) * width
        # A random order for each axis (Latin hypercube): slices of different axes must not go together.
        for i in range(size - 1, 0, -1):
            j = int(uniform(state) * (i + 1))
            population[i, d], population[j, d] = population[j, d], population[i, d]


@njit("void(f8[:,::1], i8, f8[:,::1], f8, f8, f8[::1], u8[::1])", cache=True, nogil=True)
def propose(population, i, bounds, factor, crossover, trial, state):
    """Write the trial of member i: v = a + F (b - c), binomial crossover, bounced back into the box."""
    size, dimensions = population.shape
    a = i
    while a == i:
        a = int(uniform(state) * size)
    b = a
    while b in (i, a):
        b = int(uniform(state) * size)
    c = b
    while c in (i, a, b):
        c = int(uniform(state) * size)
    forced = int(uniform(state) * dimensions)
    for d in range(dimensions):
        if uniform(state) < crossover or d == forced:
            value = population[a, d] + factor * (population[b, d] - population[c, d])
            # Between the base and the border it crossed (Price et al. 2005): clipping would pile members up
            # there.
            if value < bounds[0, d]:
                value = bounds[0, d] + uniform(state) * (population[a, d] - bounds[0, d])
            elif value > bounds[1, d]:
                value = bounds[1, d] - uniform(state) * (bounds[1, d] - population[a, d])
            trial[d] = value
        else:
            trial[d] = population[i, d]


@njit("b1(f8[:,::1], f8[::1])", cache=True, nogil=True)
def gathered(population, spread):
    """Whether the population lies within `spread` (D,) in every axis."""
    size, dimensions = population.shape
    for d in range(dimensions):
        low = high = population[0, d]
        for i in range(1, size):
            low = min(low, population[i, d])
            high = max(high, population[i, d])
        if high - low > spread[d]:
            return False
    return True
