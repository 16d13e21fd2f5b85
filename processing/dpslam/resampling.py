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


def sparing(
    parents: NDArray[np.int32], log_weights: NDArray[np.float64], spared: int
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Let one particle live on in a selection under its own weight, where it was not drawn.

    Args:
        parents: (P,) drawn, every survivor in its place.
        log_weights: (P,) normalised, before the selection.
        spared: The particle.

    Returns:
        (P,) parents and (P,) normalised log weights after the selection. A particle that was not drawn weighs
        less than one in P; with that chance to be drawn besides, it counts at most twice.
    """
    particles = len(parents)
    if parents[spared] == spared:
        return parents, np.full(particles, -np.log(particles))
    parents = parents.copy()
    parents[spared] = spared
    own = np.exp(log_weights[spared])
    after = np.full(particles, np.log((1.0 - own) / (particles - 1)))
    after[spared] = log_weights[spared]
    return parents, after
