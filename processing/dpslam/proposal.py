"""Where particles may be after a motion: its covariance as noise, and the prior of a refinement."""

import numpy as np
from numpy.typing import NDArray

Matrix = NDArray[np.float64]

NOISE_M = 0.005
NOISE_RAD = 0.002
"""Least noise of a predicted motion: no matcher is better than its points."""
MOST_NOISE = np.array((0.5, 0.5, 0.3))
"""Noise beyond which a motion is as good as unknown; m, m, rad."""


def noise_root(covariance: Matrix) -> Matrix:
    """Return R (3, 3) with R R^T = covariance + the least noise, each spread held under the most."""
    values, vectors = np.linalg.eigh(covariance + np.diag((NOISE_M**2, NOISE_M**2, NOISE_RAD**2)))
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    spread = np.sqrt((root**2).sum(axis=1))
    return np.asarray(root * np.minimum(1.0, MOST_NOISE / spread)[:, None])


def priors(root: Matrix, prior_m: float, prior_rad: float, yaw_rad: NDArray[np.float64]) -> Matrix:
    """Return the information (P, 3, 3), map axes, that ties each particle to its predicted pose.

    Args:
        root: (3, 3) of the motion's covariance, laser frame: what the matcher does not know does not tie.
        prior_m: How far the map may pull a particle all the same, one sigma.
        prior_rad: The same in rotation.
        yaw_rad: (P,) headings of the predicted poses.
    """
    trust = np.diag((prior_m**2, prior_m**2, prior_rad**2)) + root @ root.T
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.zeros((len(yaw_rad), 3, 3))
    turn[:, 0, 0], turn[:, 0, 1], turn[:, 1, 0], turn[:, 1, 1], turn[:, 2, 2] = c, -s, s, c, 1.0
    return np.ascontiguousarray(turn @ np.linalg.inv(trust) @ turn.transpose(0, 2, 1))
