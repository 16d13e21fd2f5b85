"""The most probable path under relations between poses: a chain of motions, bent by what closes its loops.

Gauss-Newton on the relations, each step solved by conjugate gradients whose preconditioner is the exact
solution of the chain alone: as many rounds as there are loops, not as there are poses. Relations that may be
wrong carry a robust loss (Geman and McClure, as Agarwal et al. 2013 use it for switchable constraints).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing import smoothing_kernels as kernels
from processing.se2 import Pose


@dataclass(frozen=True, slots=True, eq=False)
class Relations:
    """How poses were seen from other poses."""

    ends: NDArray[np.int64]
    """(E, 2) indices i, j: pose j was measured from pose i."""
    i_t_j: NDArray[np.float64]
    """(E, 3) measured poses."""
    information: NDArray[np.float64]
    """(E, 3, 3) inverse covariances, in the frame of j."""
    bends: NDArray[np.float64]
    """(E,) chi-square at which a relation begins to be doubted; 0 = never doubted."""


@dataclass(frozen=True, slots=True, eq=False)
class Smoothed:
    """A path and how well it satisfies each relation."""

    poses: Pose
    """(N, 3); the first stays where it was."""
    chi2: NDArray[np.float64]
    """(E,) squared normalised errors, 3 degrees of freedom each."""


def smooth(poses: Pose, relations: Relations, rounds: int = 10) -> Smoothed:
    """Return the path that satisfies the relations best, near the given one.

    Args:
        poses: (N, 3) start; it is not changed.
        relations: Between them; each pose must be linked to the first by some chain of consecutive relations.
        rounds: Most Gauss-Newton steps.
    """
    ends = np.ascontiguousarray(relations.ends, dtype=np.int64)
    measured = np.ascontiguousarray(relations.i_t_j, dtype=np.float64)
    information = np.ascontiguousarray(relations.information, dtype=np.float64)
    bends = np.ascontiguousarray(relations.bends, dtype=np.float64)
    at = np.array(poses, dtype=np.float64)
    count = len(at)
    diagonal, off = np.empty((count, 3, 3)), np.empty((len(ends), 3, 3))
    gradient, step = np.empty((count, 3)), np.empty((count, 3))
    chi2, trial_chi2 = np.empty(len(ends)), np.empty(len(ends))
    cost = kernels.chi_squares(at, ends, measured, information, bends, chi2)
    damping = 0.0
    for _ in range(rounds):
        weights = np.where(bends > 0.0, (bends / np.maximum(bends + chi2, 1e-12)) ** 2, 1.0)
        kernels.linearise(at, ends, measured, information, weights, diagonal, off, gradient)
        if damping:
            diagonal += damping * np.eye(3)
        kernels.conjugate_gradient(diagonal, ends, off, -gradient, step, 500, 1e-5)
        trial = at + step
        trial_cost = kernels.chi_squares(trial, ends, measured, information, bends, trial_chi2)
        if trial_cost >= cost:
            if damping > 1e6:
                break
            damping = max(damping * 10.0, 1.0)
            continue
        settled = cost - trial_cost < 1e-4 * cost
        at, cost, damping = trial, trial_cost, damping * 0.1
        chi2, trial_chi2 = trial_chi2, chi2
        if settled:
            break
    at[:, 2] = (at[:, 2] + np.pi) % (2.0 * np.pi) - np.pi
    return Smoothed(at, chi2)
