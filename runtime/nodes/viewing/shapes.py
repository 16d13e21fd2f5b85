"""Shapes to draw, from arrays and clouds: points, coarser maps, the outline of an uncertainty."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.se2 import Pose, transform

Points = NDArray[np.float64]

BLIND_M = 1.5
"""Half the length of the line that shows the direction the match does not see."""
_CHI2_95 = 5.991  # of two degrees of freedom


def cloud_points(cloud: Any) -> Points:
    """Return x and y (M, 2) of a PointCloud2 of single-precision fields; raises ValueError for others."""
    offsets = {field.name: field.offset for field in cloud.fields if field.datatype == 7}
    if not {"x", "y"} <= offsets.keys():
        raise ValueError("a cloud without float32 x and y")
    layout = np.dtype(
        {
            "names": ["x", "y"],
            "formats": ["<f4", "<f4"],
            "offsets": [offsets["x"], offsets["y"]],
            "itemsize": cloud.point_step,
        }
    )
    points = np.frombuffer(cloud.data, dtype=layout, count=cloud.width * cloud.height)
    return np.column_stack((points["x"], points["y"])).astype(np.float64)


def shrunk(cells: NDArray[np.int8], by: int) -> NDArray[np.int8]:
    """Merge blocks of `by` cells a side into their most occupied one; -1 is unknown."""
    if by <= 1:
        return cells.copy()
    rows, cols = (-(-n // by) * by for n in cells.shape)
    padded = np.full((rows, cols), -1, dtype=np.int8)
    padded[: cells.shape[0], : cells.shape[1]] = cells
    return np.asarray(padded.reshape(rows // by, by, cols // by, by).max(axis=(1, 3)))


def outline(pose: Pose, covariance: NDArray[np.float64]) -> Points:
    """Return the outline (K, 2) of where the laser is with 95 %; at least 3 cm, at most 30 m."""
    values, vectors = np.linalg.eigh(covariance)
    half = np.clip(np.sqrt(_CHI2_95 * np.maximum(values, 0.0)), 0.03, 30.0)
    turn = np.linspace(0.0, 2.0 * np.pi, 49)
    circle = np.column_stack((half[0] * np.cos(turn), half[1] * np.sin(turn)))
    return np.asarray(pose[:2] + circle @ vectors.T)


def unseen(map_t_laser: Pose, covariance: NDArray[np.float64]) -> Points:
    """Return the ends (2, 2) of a line through the laser along what it knows least."""
    along = np.linalg.eigh(covariance[:2, :2])[1][:, 1]
    return transform(map_t_laser, np.array((-BLIND_M * along, BLIND_M * along)))
