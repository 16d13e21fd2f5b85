"""Differential evolution DE/rand/1/bin (Storn and Price 1997), with three stopping rules.

What the paper leaves open, decided here: the box is given by the caller and members that leave it bounce
back; member 0 starts at the caller's guess, the others in a Latin hypercube; all trials of a generation
come from the old population; random numbers are the caller's.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.evolution_kernels import gathered, propose, scatter


@dataclass(frozen=True, slots=True, kw_only=True)
class EvolutionConfig:
    """Size and steps of the search."""

    population: int = 40
    generations: int = 30
    """The search ends here at the latest."""
    factor: float = 0.7
    """F, on the difference of two members."""
    crossover: float = 0.95
    """CR, chance of each axis to come from the mutant."""
    enough: float = np.inf
    """The search ends when its best member reaches this value."""
    spread: tuple[float, ...] = (0.005, 0.005, 0.003)
    """The search ends when all members lie this close together on every axis."""

    def __post_init__(self) -> None:
        if not 4 <= self.population <= 10_000:
            raise ValueError(
                f"population = {self.population}, must be in [4, 10000]: a trial mixes four members"
            )
        if not 0 <= self.generations <= 10_000:
            raise ValueError(f"generations = {self.generations}, must be in [0, 10000]")
        if not 0.0 < self.factor <= 2.0:
            raise ValueError(f"factor = {self.factor}, must be in (0, 2]")
        if not 0.0 <= self.crossover <= 1.0:
            raise ValueError(f"crossover = {self.crossover}, must be in [0, 1]")
        if np.isnan(self.enough):
            raise ValueError("enough = nan, must be a number or infinity")
        if not all(width >= 0.0 for width in self.spread):
            raise ValueError(f"spread = {self.spread}, must not be negative")

    def rule(self) -> NDArray[np.float64]:
        """Return the numbers that the compiled search takes."""
        return np.array((self.generations, self.factor, self.crossover, self.enough, *self.spread))


TABLE_1 = EvolutionConfig(population=100, generations=50, factor=1.0, crossover=0.95)
"""The paper's values."""


@dataclass(frozen=True, slots=True, eq=False)
class Optimum:
    """What the search found."""

    place: NDArray[np.float64]
    """(D,) best member."""
    value: float
    generations: int
    evaluations: int
    population: NDArray[np.float64]
    """(NP, D) all members, at the end."""


def random_state(seed: int) -> NDArray[np.uint64]:
    """Return the state of the random numbers for a seed."""
    if not 0 <= seed < 2**64:
        raise ValueError(f"seed = {seed}, must be in [0, 2^64)")
    return np.array((seed,), np.uint64)


def maximise(
    objective: Callable[[NDArray[np.float64]], float],
    bounds: NDArray[np.float64],
    config: EvolutionConfig,
    state: NDArray[np.uint64],
    guess: NDArray[np.float64] | None = None,
) -> Optimum:
    """Search the box `bounds` (2, D) for the greatest value of any function of a place (D,).

    The same steps in the same order as the compiled search of `processing.matching`, for functions in Python.
    """
    dimensions = bounds.shape[1]
    if bounds.shape != (2, dimensions) or not np.all(bounds[0] <= bounds[1]):
        raise ValueError(f"bounds must be (2, D) with lower <= upper, got {bounds.tolist()}")
    if len(config.spread) != dimensions:
        raise ValueError(f"spread has {len(config.spread)} axes, must have {dimensions} as the bounds")
    bounds = np.ascontiguousarray(bounds, np.float64)
    spread = np.array(config.spread)
    population = np.empty((config.population, dimensions))
    trials = np.empty_like(population)
    scatter(population, bounds, state)
    if guess is not None:
        population[0] = guess
    values = np.array([objective(member) for member in population])
    used = 0
    while used < config.generations and values.max() < config.enough and not gathered(population, spread):
        for i in range(config.population):
            propose(population, i, bounds, config.factor, config.crossover, trials[i], state)
        for i, trial in enumerate(trials):
            value = objective(trial)
            if value >= values[i]:
                values[i] = value
                population[i] = trial
        used += 1
    best = int(np.argmax(values))
    return Optimum(
        population[best].copy(), float(values[best]), used, config.population * (used + 1), population
    )
