"""Poses in the plane: arrays of x, y (metres) and yaw (radians, counter-clockwise), composed by name.

`a_t_b` is the pose of frame b seen from frame a; `compose(a_t_b, b_t_c)` reads by cancelling the inner names.
Every function takes one pose (3,) or many (..., 3).
"""

from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

Pose: TypeAlias = NDArray[np.float64]

# A grid of about 1e-12 rad: far under any sensor, far over the rounding of a quaternion (see `snap_yaw`).
_YAW_STEPS_PER_RAD = 2.0**40
_YAW_STEPS_HALF_TURN = np.floor(np.pi * _YAW_STEPS_PER_RAD)


def wrap(angle_rad: ArrayLike) -> NDArray[np.float64]:
    """Bring angles into [-pi, pi)."""
    angle = np.asarray(angle_rad, dtype=np.float64)
    return (angle + np.pi) % (2.0 * np.pi) - np.pi


def compose(a_t_b: Pose, b_t_c: Pose) -> Pose:
    """Return a_t_c, the pose of c seen from a."""
    a_t_b, b_t_c = np.asarray(a_t_b, dtype=np.float64), np.asarray(b_t_c, dtype=np.float64)
    c, s = np.cos(a_t_b[..., 2]), np.sin(a_t_b[..., 2])
    x = a_t_b[..., 0] + c * b_t_c[..., 0] - s * b_t_c[..., 1]
    y = a_t_b[..., 1] + s * b_t_c[..., 0] + c * b_t_c[..., 1]
    return _pose(x, y, wrap(a_t_b[..., 2] + b_t_c[..., 2]))


def invert(a_t_b: Pose) -> Pose:
    """Return b_t_a."""
    a_t_b = np.asarray(a_t_b, dtype=np.float64)
    c, s = np.cos(a_t_b[..., 2]), np.sin(a_t_b[..., 2])
    x = -c * a_t_b[..., 0] - s * a_t_b[..., 1]
    y = s * a_t_b[..., 0] - c * a_t_b[..., 1]
    return _pose(x, y, wrap(-a_t_b[..., 2]))


def between(a_t_b: Pose, a_t_c: Pose) -> Pose:
    """Return b_t_c: how c lies seen from b."""
    return compose(invert(a_t_b), a_t_c)


def _pose(x: NDArray[np.float64], y: NDArray[np.float64], yaw: NDArray[np.float64]) -> Pose:
    """Put coordinates (...) together to poses (..., 3), in half the time of `np.stack` for one."""
    pose = np.empty((*x.shape, 3))
    pose[..., 0], pose[..., 1], pose[..., 2] = x, y, yaw
    return pose


def transform(a_t_b: Pose, points_b: NDArray[np.float64]) -> NDArray[np.float64]:
    """Express points (N, 2) of frame b in frame a, for one pose (3,)."""
    c, s = np.cos(a_t_b[2]), np.sin(a_t_b[2])
    rotation = np.array(((c, s), (-s, c)))
    return np.asarray(points_b @ rotation + a_t_b[:2])


def snap_yaw(a_t_b: Pose) -> Pose:
    """Round the yaw to a grid of 2^-40 rad, so that a quaternion carries it there and back without loss.

    Sine and cosine of half the angle give it back with an error near 1e-16; rounding both before and after
    restores every bit, which makes a run through messages equal to a run in one process.
    """
    snapped = np.array(a_t_b, dtype=np.float64)
    steps = np.round(wrap(snapped[..., 2]) * _YAW_STEPS_PER_RAD)
    # The last grid points inside the half circle: rounding must not leave it and come back on the other side.
    steps = np.clip(steps, -_YAW_STEPS_HALF_TURN, _YAW_STEPS_HALF_TURN)
    snapped[..., 2] = steps / _YAW_STEPS_PER_RAD
    return snapped
