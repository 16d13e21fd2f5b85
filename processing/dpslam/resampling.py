"""Weights of particles and their selection: systematic resampling in which every survivor keeps its place."""

import numpy as np
from numpy.typing import NDArray


def normalise(log_weights: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return log weights shifted so that their exponentials sum to one."""
    peak = float(log_weights.max())
    return np.asarray(log_weights - (peak + np.log(np.exp(log_weights - peak).sum())))


def effective_size(log_weights: NDArray[np.float64]) -> float:
    """Return 1 / sum of squared weights: how many particles really share the probability."""
    return float(1.0 / np.exp(2.0 * normalise(log_weights)).sum())


def systematic_parents(log_weights: NDArray[np.float64], u: float) -> NDArray[np.int32]:
    """Draw the parent of each particle; particle k gets floor or ceil of P w_k descendants.

    Args:
        log_weights: (P,) any offset.
        u: One uniform number in [0, 1).

    Returns:
        (P,) parents, arranged so that `parents[k] == k` for every survivor k: only the places of the dead
        change.
    """
    particles = log_weights.shape[0]
    edges = np.cumsum(np.exp(normalise(log_weights)))
    # The sum may miss one by rounding; the last particle must not be drawn for that.
    edges /= edges[-1]
    # Under one even when rounded: the last place may belong to a particle without weight.
    at = np.minimum((u + np.arange(particles)) / particles, np.nextafter(1.0, 0.0))
    children = np.bincount(np.searchsorted(edges, at, side="right"), minlength=particles)
    parents = np.arange(particles, dtype=np.int32)
    parents[children == 0] = np.repeat(parents, np.maximum(children - 1, 0))
    return parents
