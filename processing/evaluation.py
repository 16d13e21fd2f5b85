"""How good a trajectory is: Kümmerle's relations, absolute error after alignment, relative along the way.

Pure arrays in, arrays out; association by stamp is here too, because it decides what is compared.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.se2 import Pose, between, compose


@dataclass(frozen=True, slots=True, eq=False)
class PoseErrors:
    """Errors of many compared poses, never negative."""

    translation_m: NDArray[np.float64]
    """(N,)"""
    rotation_deg: NDArray[np.float64]
    """(N,)"""

    def __len__(self) -> int:
        return len(self.translation_m)


@dataclass(frozen=True, slots=True)
class Summary:
    """The figures by which errors are published."""

    mean: float
    std: float
    rmse: float
    median: float
    p95: float
    max: float


def summarise(errors: NDArray[np.float64]) -> Summary:
    """Return mean, standard deviation (of the population), and the rest of (N,) errors, N >= 1."""
    if len(errors) == 0:
        raise ValueError("0 errors, must be at least 1 to summarise")
    return Summary(
        mean=float(errors.mean()),
        std=float(errors.std()),
        rmse=float(np.sqrt(np.mean(errors**2))),
        median=float(np.median(errors)),
        p95=float(np.percentile(errors, 95)),
        max=float(errors.max()),
    )


def pose_errors(truth: Pose, estimate: Pose) -> PoseErrors:
    """Return size of translation and rotation of truth^-1 * estimate, poses (N, 3)."""
    error = between(truth, estimate)
    return PoseErrors(np.hypot(error[:, 0], error[:, 1]), np.abs(np.degrees(error[:, 2])))


def relation_errors(map_t_a: Pose, map_t_b: Pose, a_t_b: Pose) -> PoseErrors:
    """Compare relative poses with the truth, as Kümmerle et al. (2009) do.

    Args:
        map_t_a: (N, 3) estimated poses at the first stamps.
        map_t_b: (N, 3) at the second stamps.
        a_t_b: (N, 3) the true relations.

    Returns:
        The size of relation^-1 * (pose_a^-1 * pose_b).
    """
    return pose_errors(a_t_b, between(map_t_a, map_t_b))


def nearest_stamps(
    stamps_ns: NDArray[np.int64], wanted_ns: NDArray[np.int64], tolerance_ns: int
) -> NDArray[np.int64]:
    """Find, for each wanted stamp, the pose whose stamp is nearest.

    Args:
        stamps_ns: (N,) in any order; of equal stamps the first counts.
        wanted_ns: (M,)
        tolerance_ns: Largest difference that still counts as the same moment.

    Returns:
        (M,) indices into `stamps_ns`; -1 where none is within the tolerance.
    """
    order = np.argsort(stamps_ns, kind="stable")
    ordered = stamps_ns[order]
    right = np.searchsorted(ordered, wanted_ns, side="left")
    left = np.clip(right - 1, 0, len(ordered) - 1)
    right = np.clip(right, 0, len(ordered) - 1)
    take_left = np.abs(wanted_ns - ordered[left]) < np.abs(wanted_ns - ordered[right])
    best = np.where(take_left, left, right)
    best = np.searchsorted(ordered, ordered[best], side="left")  # the first of equal stamps
    close = np.abs(ordered[best] - wanted_ns) <= tolerance_ns
    return np.where(close, order[best], -1).astype(np.int64)


def align(reference: Pose, estimate: Pose) -> Pose:
    """Return reference_t_estimate (3,), the rigid motion that lays positions (N, 3) best on the reference."""
    a, b = reference[:, :2], estimate[:, :2]
    da, db = a - a.mean(axis=0), b - b.mean(axis=0)
    yaw = np.arctan2(np.sum(db[:, 0] * da[:, 1] - db[:, 1] * da[:, 0]), np.sum(da * db))
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = a.mean(axis=0) - np.array(((c, -s), (s, c))) @ b.mean(axis=0)
    return np.array((x, y, yaw))


def absolute_errors(reference: Pose, estimate: Pose) -> PoseErrors:
    """Return the errors (ATE) of poses (N, 3) after the best rigid alignment of the positions."""
    return pose_errors(reference, compose(align(reference, estimate), estimate))


def relative_errors(reference: Pose, estimate: Pose, distance_m: float) -> PoseErrors:
    """Return the drift (RPE) over stretches of the way.

    Args:
        reference: (N, 3) true poses, in time.
        estimate: (N, 3) poses at the same moments.
        distance_m: Length of a stretch along the reference; one starts at every pose, as far as the way goes.

    Returns:
        Errors of each stretch; none when the way is shorter than `distance_m`.
    """
    if not distance_m > 0.0:
        raise ValueError(f"distance_m = {distance_m}, must be positive")
    way_m = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(reference[:, :2], axis=0).T))))
    end = np.searchsorted(way_m, way_m + distance_m)
    begin = np.flatnonzero(end < len(way_m))
    end = end[begin]
    return relation_errors(estimate[begin], estimate[end], between(reference[begin], reference[end]))
