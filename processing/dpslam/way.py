"""The way so far: key scans along a path, what ties them to each other, and how far the path may be off.

Relations are of two kinds: the motions of the scan matcher between key scans, never doubted; and places where
a key scan was found to lie on what an earlier one saw, which may be wrong and are doubted when they disagree.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.drift import Drift
from processing.dpslam.places import Places
from processing.dpslam.thinning import thinned
from processing.growing import Growing
from processing.ndt import Points
from processing.se2 import Pose, between, compose, transform
from processing.smoothing import Relations, smooth

Matrix = NDArray[np.float64]

POINT_GAIN = 0.3
"""Information of a point that fits: neighbouring points err alike."""
NO_POINTS = np.zeros((0, 2))
EVEN_M = 0.1
"""One point is kept in each square of this edge where points of a stretch of way are put together."""


class Way:
    """The K key scans of one lineage."""

    def __init__(self) -> None:
        self.path: Pose = np.zeros((0, 3))
        """(K, 3) map_t_laser of each."""
        self.points: list[Points] = []
        """(N, 2) of each, m, laser frame; none where newer key scans stand for it."""
        self.places = Places()
        self.drift = Drift()
        self._motions, self._lengths_m = Growing((3,)), Growing()
        self._points_kept = 0

    @property
    def bytes_used(self) -> int:
        """Memory of the points kept."""
        return self._points_kept * 16

    @property
    def lengths_m(self) -> NDArray[np.float64]:
        """(K,) length of the way up to each key scan."""
        return self._lengths_m.rows

    def go_on(self, motion: Pose, step: Matrix, points: Points) -> None:
        """Add a key scan; its place on the path comes with the path.

        Args:
            motion: (3,) from the key scan before; of the first, anything.
            step: (3, 3) by which the path drifts in that motion, in the new laser frame.
            points: (N, 2) m, laser frame.
        """
        first = not self.points
        self.points.append(points)
        self._points_kept += len(points)
        self._motions.append(motion)
        step_m = 0.0 if first else float(np.hypot(motion[0], motion[1]))
        self._lengths_m.append(step_m + (0.0 if first else self.lengths_m[-1]))
        self.drift.go_on(step, motion)

    def forget(self, key: int) -> None:
        """Let go of the points of a key scan."""
        self._points_kept -= len(self.points[key])
        self.points[key] = NO_POINTS

    def relate(self, near: int, map_t_laser: Pose, information: Matrix, doubt: float) -> Matrix:
        """Add the relation of the newest key scan, where it was found (3,), to an earlier one.

        Args:
            near: The earlier one.
            map_t_laser: (3,) the place of the newest.
            information: (3, 3) of the place, map axes, one unit a point.
            doubt: Chi-square at which the relation is doubted; 0 for never.

        Returns:
            What the relation is taken to know, (3, 3) in the newest laser's frame.
        """
        known = in_map(POINT_GAIN * information, -map_t_laser[2]) + 1e-3 * np.eye(3)
        measured = between(self.path[near], map_t_laser)
        self.places.add((near, len(self.path) - 1), measured, known, doubt)
        self.drift.find(near, measured, known)
        return known

    def smoothed(self) -> Pose:
        """Return the path (K, 3) that satisfies all relations best."""
        return smooth(self.path, self._relations()).poses if len(self.path) > 1 else self.path.copy()

    def settled(self) -> Pose:
        """Return the path (K, 3) that satisfies all relations best; past the last of them it keeps its shape.

        There nothing is told but the motions, and the particles have done better: on their own maps.
        """
        last = int(self.places.ends.rows[:, 1].max())
        path = self.smoothed()
        path[last + 1 :] = compose(path[last], between(self.path[last], self.path[last + 1 :]))
        return path

    def since(self, first: int) -> Points:
        """Gather the points of the key scans from one on, evenly, in the newest laser frame (N, 2)."""
        here = self.path[-1]
        parts = [
            transform(between(here, self.path[k]), self.points[k]) for k in range(first, len(self.points))
        ]
        return thinned(np.vstack(parts), EVEN_M)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return everything as arrays; `restore` takes it back."""
        places = self.places
        return {
            "path": self.path.copy(),
            "points": np.vstack((np.zeros((0, 2)), *self.points)),
            "counts": np.array([len(points) for points in self.points], dtype=np.int64),
            "motions": self._motions.rows.copy(),
            "covariances": self.drift.steps.rows.copy(),
            "drift": self.drift.errors.rows.copy(),
            "way_m": self.lengths_m.copy(),
            "place_ends": places.ends.rows.copy(),
            "place_poses": places.poses.rows.copy(),
            "place_informations": places.informations.rows.copy(),
            "place_doubts": places.doubts.rows.copy(),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Become the way whose `state` was taken."""
        self.path = state["path"].copy()
        ends = np.cumsum(state["counts"])[:-1]
        self.points = [part.copy() for part in np.split(state["points"], ends)] if len(self.path) else []
        self._points_kept = len(state["points"])
        self._motions.replace(state["motions"])
        self.drift.steps.replace(state["covariances"])
        self.drift.errors.replace(state["drift"])
        self._lengths_m.replace(state["way_m"])
        self.places.ends.replace(state["place_ends"])
        self.places.poses.replace(state["place_poses"])
        self.places.informations.replace(state["place_informations"])
        self.places.doubts.replace(state["place_doubts"])

    def _relations(self) -> Relations:
        chain = np.arange(1, len(self.path))
        places = self.places
        return Relations(
            np.concatenate((np.column_stack((chain - 1, chain)), places.ends.rows)),
            np.concatenate((self._motions.rows[1:], places.poses.rows)),
            np.concatenate((np.linalg.inv(self.drift.steps.rows[1:]), places.informations.rows)),
            np.concatenate((np.zeros(len(chain)), places.doubts.rows)),
        )


def in_map(matrix: Matrix, yaw_rad: float) -> Matrix:
    """Turn a covariance or information (3, 3) of a laser's frame into the map's axes."""
    c, s = np.cos(yaw_rad), np.sin(yaw_rad)
    turn = np.array(((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0)))
    return np.asarray(turn @ matrix @ turn.T)
