"""A constant-velocity filter: where the next scan should be, and how far it may be from there.

State: pose of the laser in the odometry frame, and its twist; errors of both are kept in the laser's own
frame. It never sees a clock: the time between two scans is the sensor's own period, because arrival stamps
jitter by half a period, and a velocity divided by such a time throws the track off.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from processing.se2 import Pose, between, compose, invert, wrap

Twist = NDArray[np.float64]
Matrix = NDArray[np.float64]

LEAST_INFORMATION = 1e-6
"""Keeps what is not seen at all finite, 1/m^2 and 1/rad^2."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PredictionConfig:
    """How fast a robot, or a hand, changes its velocity."""

    acceleration: float = 1.0
    """Standard deviation of the change of velocity in one second, m/s."""
    turning: float = 3.0
    """The same of the turn rate, rad/s."""
    speed_m_s: float = 0.3
    """Standard deviation of the velocity when nothing is known of it; the start is taken to be at rest."""
    turn_rate_rad_s: float = 0.5

    def __post_init__(self) -> None:
        for name in ("acceleration", "turning", "speed_m_s", "turn_rate_rad_s"):
            if not 0.0 < getattr(self, name) <= 100.0:
                raise ValueError(f"{name} = {getattr(self, name)}, must be in (0, 100]")


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """What the motion so far says of a pose: a normal around `pose`."""

    pose: Pose
    """(3,) odometry frame."""
    information: Matrix
    """(3, 3) inverse covariance, on the axes of the odometry frame."""

    def sigmas(self, pose: Pose) -> float:
        """Return how far a pose (3,) is from the expected one."""
        off = pose - self.pose
        off[2] = wrap(off[2])
        return float(np.sqrt(off @ self.information @ off))


def exponential(twist: Twist) -> Pose:
    """Return the pose reached after one unit of time at a constant twist (3,)."""
    a = twist[2]
    along = np.sinc(a / np.pi)
    across = 0.5 * a * np.sinc(0.5 * a / np.pi) ** 2
    return np.array((along * twist[0] - across * twist[1], across * twist[0] + along * twist[1], a))


def logarithm(pose: Pose) -> Twist:
    """Return the twist that reaches `pose` (3,) in one unit of time; the inverse of `exponential`."""
    half = 0.5 * pose[2]
    k = 1.0 if abs(half) < 1e-9 else half / np.tan(half)
    return np.array((k * pose[0] + half * pose[1], k * pose[1] - half * pose[0], pose[2]))


def adjoint(a_t_b: Pose) -> Matrix:
    """Return the matrix that carries small motions (3,) in frame b to frame a."""
    c, s = np.cos(a_t_b[2]), np.sin(a_t_b[2])
    return np.array(((c, -s, a_t_b[1]), (s, c, -a_t_b[0]), (0.0, 0.0, 1.0)))


def turned(matrix: Matrix, yaw_rad: float) -> Matrix:
    """Express a (3, 3) matrix of x, y, yaw on axes that are turned back by `yaw_rad`: R M R^T."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    rotation = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    return np.asarray(rotation @ matrix @ rotation.T)


def weakened(information_laser: Matrix, prior: Prior, pose: Pose) -> Matrix:
    """Return the information (3, 3), laser's axes, of a match that may as well be wrong.

    Where the scan lies is then what the motion says of it, and the match is as far off as it is from there.

    Args:
        information_laser: (3, 3) that the match claims.
        prior: Where the scan was expected, and
        pose: (3,) where it was found.
    """
    expected = np.linalg.inv(turned(prior.information, -pose[2]))
    off = logarithm(between(prior.pose, pose))
    claimed = np.linalg.inv(information_laser + LEAST_INFORMATION * np.eye(3))
    return np.asarray(np.linalg.inv(claimed + expected + np.outer(off, off)))


class ConstantVelocity:
    """Pose and twist of the laser with their covariance (6, 6), in the laser's frame."""

    def __init__(self, config: PredictionConfig) -> None:
        self._config = config
        self.pose: Pose = np.zeros(3)
        self.twist: Twist = np.zeros(3)
        self.covariance: Matrix = np.zeros((6, 6))
        self.forget_velocity()

    def forget_velocity(self) -> None:
        """Return to rest, with the doubt of a start."""
        c = self._config
        self.twist = np.zeros(3)
        self.covariance[:] = 0.0
        self.covariance[range(6), range(6)] = (
            *(1e-8,) * 3,
            c.speed_m_s**2,
            c.speed_m_s**2,
            c.turn_rate_rad_s**2,
        )

    @property
    def doubt_m_s(self) -> float:
        """Standard deviation of the velocity in the direction that is known worst."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance[3:5, 3:5])[-1]))

    def drift_m(self, duration_s: float) -> float:
        """Return the standard deviation of a place after a time in which nothing but the motion was known."""
        return float(self._config.acceleration * np.sqrt(duration_s**3 / 3.0))

    def advance(self, duration_s: float) -> Prior:
        """Move on by a time; return what is expected there."""
        c = self._config
        motion = exponential(self.twist * duration_s)
        self.pose = compose(self.pose, motion)
        step = np.eye(6)
        step[:3, :3] = adjoint(invert(motion))
        step[:3, 3:] = duration_s * np.eye(3)
        noise = np.array((c.acceleration**2, c.acceleration**2, c.turning**2))
        # Velocity is a random walk; the pose integrates it.
        covariance = step @ self.covariance @ step.T
        i = np.arange(3)
        covariance[i, i] += noise * duration_s**3 / 3.0
        covariance[i, i + 3] += noise * duration_s**2 / 2.0
        covariance[i + 3, i] += noise * duration_s**2 / 2.0
        covariance[i + 3, i + 3] += noise * duration_s
        self.covariance = covariance
        return self.prior()

    def prior(self) -> Prior:
        """Return what is expected now."""
        information = np.asarray(np.linalg.inv(self.covariance[:3, :3]), np.float64)
        return Prior(self.pose, turned(information, self.pose[2]))

    def see_turn(self, rate_rad_s: float, deviation_rad_s: float) -> Prior:
        """Take in the turn rate that the laser has now, and how well it is known; return what is expected."""
        gain = self.covariance[:, 5] / (self.covariance[5, 5] + deviation_rad_s**2)
        change = gain * (rate_rad_s - self.twist[2])
        self.pose = compose(self.pose, exponential(change[:3]))
        self.twist = self.twist + change[3:]
        self.covariance = self.covariance - np.outer(gain, self.covariance[5])
        return self.prior()

    def bound(self, unseen: NDArray[np.float64], steady: bool) -> None:
        """Hold the doubt of the velocity along unseen directions (K, 2), laser frame, to that of a start.

        A random walk that nobody corrects would soon allow any speed. Of a laser whose velocity was steady
        the place is held as well, to where such a doubt leads in a scan or two: more, and whoever walks by
        draws it along. One that was not steady may be far off by now, until something in sight tells.
        """
        for direction in unseen:
            deviation = float(np.sqrt(direction @ self.covariance[3:5, 3:5] @ direction))
            if deviation > self._config.speed_m_s:
                shrink = np.eye(6)
                along = np.outer(direction, direction) * (1.0 - self._config.speed_m_s / deviation)
                shrink[3:5, 3:5] -= along
                if steady:
                    shrink[:2, :2] -= along
                self.covariance = shrink @ self.covariance @ shrink.T

    def steer(self, unseen: NDArray[np.float64], velocity: NDArray[np.float64]) -> None:
        """Take up a velocity (2,) along unseen directions (K, 2), both in the laser's frame."""
        self.twist[:2] += unseen.T @ (unseen @ (velocity - self.twist[:2]))

    def correct(self, pose: Pose, information_laser: Matrix, telling_s: Matrix | None = None) -> Twist:
        """Take the pose (3,) found by matching, prior included; return how far it is from the expected one.

        What tells of a slow sweep may all have been seen at its end; a wrong velocity has moved it till then,
        and the pose that was found is wrong by as much. Taken for a pose of the middle, it makes the velocity
        swing from scan to scan.

        Args:
            pose: Most probable pose given the prior and the scan, odometry frame.
            information_laser: (3, 3) information of the scan alone, on the laser's axes.
            telling_s: (3, 3) how long after the middle of the sweep it was seen, on the laser's axes: see
                `Matcher.telling_s`. None if all of it is of one instant.
        """
        innovation = logarithm(between(self.pose, pose))
        look = np.hstack((np.eye(3), np.zeros((3, 3)) if telling_s is None else telling_s))
        spread = self.covariance @ look.T
        # Kalman's gain times what the scan alone measured; that is what the prior has been added to.
        gain = spread @ np.linalg.inv(np.eye(3) + information_laser @ (look @ spread))
        prior = np.linalg.inv(self.covariance[:3, :3])
        change = gain @ (information_laser + prior) @ innovation
        self.covariance = self.covariance - gain @ information_laser @ spread.T
        self.covariance = 0.5 * (self.covariance + self.covariance.T)
        self.twist = self.twist + change[3:]
        self.pose = pose if telling_s is None else compose(self.pose, exponential(change[:3]))
        return innovation
