"""A round robot on two wheels in a building: it drives arcs, and stops where something stands.

The law of the file: whoever moves it passes the time; its past can be asked for at any moment, so that every
ray of a sweep is cast from where the robot was at that ray.
"""

import threading
from collections import deque

import numpy as np
from numpy.typing import ArrayLike

from drivers.world.building import Array, Building

BUMP_RIGHT = 1
"""Bit of `WheeledRobot.bumps`, as in packet 7 of the Create."""
BUMP_LEFT = 2
_MEMORY = 2048
_CONTACT_M = 1e-4


class WheeledRobot:
    """Differential drive; safe to move from one thread and to watch from another."""

    def __init__(
        self,
        building: Building,
        start: ArrayLike | None = None,
        *,
        wheel_base_m: float = 0.258,
        radius_m: float = 0.165,
        now_ns: int = 0,
    ) -> None:
        """Put the robot at `start` (3,), or at the beginning of the building's route."""
        self.building = building
        self.wheel_base_m = wheel_base_m
        self.radius_m = radius_m
        self._pose: Array = np.array(building.start if start is None else start, dtype=np.float64)
        self._twist = (0.0, 0.0)
        self._bumps = 0
        self._wheels_mps = (0.0, 0.0)
        self._past: deque[tuple[int, float, float, float]] = deque(maxlen=_MEMORY)
        self._past.append((now_ns, *self._pose))
        self._lock = threading.Lock()

    @property
    def pose(self) -> Array:
        """Where the robot is now: (3,) x, y, yaw (unwrapped) in the map frame."""
        with self._lock:
            return self._pose.copy()

    @property
    def twist(self) -> tuple[float, float]:
        """How it really moves: m/s forward and rad/s; (0, 0) while something blocks it."""
        with self._lock:
            return self._twist

    @property
    def bumps(self) -> int:
        """Which sides of the bumper are pressed: BUMP_RIGHT, BUMP_LEFT, both or 0."""
        with self._lock:
            return self._bumps

    def drive(self, left_mps: float, right_mps: float) -> None:
        """Set the speeds of the wheels; they turn so until told otherwise."""
        with self._lock:
            self._wheels_mps = (left_mps, right_mps)

    def place(self, pose: ArrayLike, now_ns: int) -> None:
        """Carry the robot somewhere else, all at once."""
        with self._lock:
            self._pose = np.array(pose, dtype=np.float64)
            self._past.append((max(now_ns, self._past[-1][0]), *self._pose))

    def advance(self, now_ns: int) -> None:
        """Let the wheels turn until `now_ns`; earlier times change nothing."""
        with self._lock:
            dt_s = (now_ns - self._past[-1][0]) * 1e-9
            if dt_s <= 0.0:
                return
            left, right = self._wheels_mps
            speed, turn = (left + right) / 2.0, (right - left) / self.wheel_base_m
            moved = _arc(self._pose, speed * dt_s, turn * dt_s)
            blocked = False
            if speed != 0.0:
                moved, blocked = self._stop_at_walls(moved)
            self._pose = moved
            self._twist = (0.0 if blocked else speed, turn)
            self._bumps = self._feel() if speed >= 0.0 else 0
            self._past.append((now_ns, *moved))

    def poses_at(self, stamps_ns: ArrayLike) -> Array:
        """Return where the robot was (N, 3) at the given times (N,); beyond now it goes on as it does."""
        stamps = np.atleast_1d(np.asarray(stamps_ns, dtype=np.int64))
        with self._lock:
            oldest_ns = int(stamps.min())
            recent = []
            for knot in reversed(self._past):
                recent.append(knot)
                if knot[0] <= oldest_ns:
                    break
            speed, turn = self._twist
        newest_ns = recent[0][0]
        times = np.array([knot[0] - newest_ns for knot in reversed(recent)], dtype=np.float64) * 1e-9
        knots = np.array([knot[1:] for knot in reversed(recent)])
        asked = (stamps - newest_ns) * 1e-9
        poses = np.stack([np.interp(asked, times, knots[:, i]) for i in range(3)], axis=-1)
        ahead = np.maximum(asked, 0.0)
        poses[:, 0] += speed * ahead * np.cos(poses[:, 2] + turn * ahead / 2.0)
        poses[:, 1] += speed * ahead * np.sin(poses[:, 2] + turn * ahead / 2.0)
        poses[:, 2] += turn * ahead
        return poses

    def _stop_at_walls(self, moved: Array) -> tuple[Array, bool]:
        """Return the pose after a step that may end at a wall, and whether it did."""
        gap, _ = self.building.nearest(moved[:2])
        if gap >= self.radius_m + _CONTACT_M:
            return moved, False
        before, _ = self.building.nearest(self._pose[:2])
        if gap >= before:  # away from the wall, or along it
            return moved, False
        # The turning goes on, the way forward ends at the wall.
        share = max(0.0, before - self.radius_m - _CONTACT_M) / max(before - gap, 1e-12)
        stopped = moved.copy()
        stopped[:2] = self._pose[:2] + min(share, 1.0) * (moved[:2] - self._pose[:2])
        return stopped, True

    def _feel(self) -> int:
        """Return the bumper bits for what touches the front half of the robot."""
        gap, place = self.building.nearest(self._pose[:2])
        if gap > self.radius_m + 2.0 * _CONTACT_M:
            return 0
        dx, dy = place - self._pose[:2]
        bearing = (np.arctan2(dy, dx) - self._pose[2] + np.pi) % (2.0 * np.pi) - np.pi
        if abs(bearing) > 1.4:
            return 0
        # One bumper with two switches: a push in the middle closes both.
        return (BUMP_LEFT if bearing > -0.4 else 0) | (BUMP_RIGHT if bearing < 0.4 else 0)


def _arc(pose: Array, length_m: float, turn_rad: float) -> Array:
    """Return the pose (3,) after a piece of a circle."""
    x, y, yaw = pose
    chord = length_m * np.sinc(turn_rad / (2.0 * np.pi))
    middle = yaw + turn_rad / 2.0
    return np.array((x + chord * np.cos(middle), y + chord * np.sin(middle), yaw + turn_rad))
