"""Where particles may be after a motion: its covariance as noise, and the prior of a refinement."""

import numpy as np
from numpy.typing import NDArray

from processing.observability import BLIND_M
from processing.se2 import Pose

Matrix = NDArray[np.float64]

NOISE_M = 0.005
NOISE_RAD = 0.002
"""Least noise of a predicted motion: no matcher is better than its points."""
WIDE_M = 0.03
WIDE_RAD = 0.01
"""Deviations of the way to one scan that need no more doubt."""
MOST_NOISE = np.array((0.5, 0.5, 0.3))
"""Noise beyond which a motion is as good as unknown; m, m, rad."""


def doubted(covariance: Matrix, doubt: float) -> Matrix:
    """Return the covariance (3, 3) of a motion whose deviations may be `doubt` times what is claimed.

    A direction that is not seen is claimed wide enough as it is.
    """
    values, vectors = np.linalg.eigh(covariance[:2, :2])
    spread = np.sqrt(np.maximum(values, 1e-12))
    grow = np.eye(3)
    grow[:2, :2] = (vectors * np.clip(WIDE_M / spread, 1.0, doubt)) @ vectors.T
    grow[2, 2] = np.clip(WIDE_RAD / np.sqrt(max(covariance[2, 2], 1e-12)), 1.0, doubt)
    return np.asarray(grow @ covariance @ grow.T)


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


def held(refined: Pose, predicted: Pose, information: Matrix) -> tuple[Pose, NDArray[np.bool_]]:
    """Return refined poses (P, 3) with the predicted position along what the own map does not see.

    As in the odometry (`observability`): the slope of the score there is the edge of the map, and pulls back.

    Args:
        refined: (P, 3) map_t_laser.
        predicted: (P, 3) by the motion.
        information: (P, 3, 3) of the refinement, map axes, one unit a point that fits; without the prior.
    """
    shared = information[:, :2, 2]
    # What is left of the position's information when the yaw is not known.
    alone = np.maximum(information[:, 2, 2], 1e-9)[:, None, None]
    position = information[:, :2, :2] - shared[:, :, None] * shared[:, None, :] / alone
    values, vectors = np.linalg.eigh(position)
    unseen = values < 1.0 / BLIND_M**2
    blind = np.asarray(unseen.any(axis=1))
    if not blind.any():
        return refined, blind
    along = np.einsum("pij,pi->pj", vectors, refined[:, :2] - predicted[:, :2]) * unseen
    poses = refined.copy()
    poses[:, :2] -= np.einsum("pij,pj->pi", vectors, along)
    return poses, blind
