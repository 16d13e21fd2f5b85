"""The local map: the newest key scans, and the reference made of what the laser can see of them from here.

A wall has two sides. Who drives out of a room into a corridor knows one side of the wall between them and
sees the other; matched on it, the scan would be off by the thickness of the wall. So the points of walls that
the laser would see from behind are left out of the reference, as what faces away is not drawn in graphics.
"""

from dataclasses import dataclass

import numpy as np

from processing.facing_kernels import look_behind
from processing.ndt import Ndt, NdtConfig, Points
from processing.se2 import Pose, transform

BEHIND_M = 0.05
BEHIND_SLANT = 0.1
"""A wall is seen from behind by a laser so far behind its line, and by the sine of this angle: more than the
noise of a cheap laser turns a normal. Walls between rooms are thicker than 0.05 m."""
CHANGE = 0.005
"""The reference is built anew when the share of the points that face away has changed by so much."""


@dataclass(frozen=True, slots=True, eq=False)
class KeyScan:
    """One scan of the local map."""

    odom_t_laser: Pose
    points_odom: Points
    normals_odom: Points
    """(N, 2) unit normals of the points' walls, towards the laser; 0 for points of no wall."""


class LocalMap:
    """Key scans in the odometry's frame, and the NDT of them that scans are matched against.

    Args:
        config: Of the reference.
        most: Number of key scans kept.
        sides: Whether what faces away is left out.
    """

    def __init__(self, config: NdtConfig, most: int, sides: bool = True) -> None:
        self._config, self._most, self._sides = config, most, sides
        self.keys: list[KeyScan] = []
        self._reference = Ndt(config)
        self._gather()
        self._place: Points | None = None
        """(2,) from where the reference is seen; None if all of it is."""
        self._stale = False
        """Whether there are key scans that the reference does not know yet."""

    def __getstate__(self) -> dict[str, object]:
        """The key scans, which give everything else again, bit for bit."""
        kept = ("_config", "_most", "_sides", "keys", "_place", "_stale")
        return {name: getattr(self, name) for name in kept}

    def __setstate__(self, state: dict[str, object]) -> None:
        vars(self).update(state)
        self._reference = Ndt(self._config)
        self._gather()
        if self.keys and not self._stale:
            self._build()

    @property
    def reference(self) -> Ndt:
        """What scans are matched against."""
        if self._stale:
            self._build()
        return self._reference

    def clear(self) -> None:
        """Forget everything; the reference stays until there is another scan."""
        self.keys.clear()
        self._place, self._stale = None, False
        self._gather()

    def add(self, odom_t_laser: Pose, points: Points, normals: Points) -> None:
        """Take a key scan, and drop the oldest if there are too many.

        Args:
            odom_t_laser: (3,) where it was taken.
            points: (N, 2) m, laser frame.
            normals: (N, 2) unit normals of their walls, towards the laser; 0 for points of no wall.
        """
        turn = np.array((0.0, 0.0, odom_t_laser[2]))
        key = KeyScan(odom_t_laser.copy(), transform(odom_t_laser, points), transform(turn, normals))
        self.keys.append(key)
        del self.keys[: -self._most]
        self._gather()
        # The next scan will see it from elsewhere: to build it now would be to build it twice.
        self._stale = True
        self._place = odom_t_laser[:2].copy() if self._sides else None

    def face(self, odom_t_laser: Pose) -> None:
        """Look at the map from a place (3,): leave out what faces away from there."""
        if self._place is None:
            return
        place = odom_t_laser[:2].copy()
        if self._stale:
            self._place = place
        elif abs(self._look(place) - self._hidden) > CHANGE * len(self._points):
            self._place = place
            self._build()

    def show_all(self) -> None:
        """Put everything into the reference: the laser may be anywhere."""
        if self._place is not None:
            self._place = None
            self._build()

    def _gather(self) -> None:
        none = np.zeros((0, 2))
        self._points = np.concatenate([none, *(key.points_odom for key in self.keys)])
        self._normals = np.concatenate([none, *(key.normals_odom for key in self.keys)])
        self._behind = np.zeros(len(self._points), np.bool_)
        self._hidden = 0

    def _look(self, place: Points) -> int:
        x, y = place.tolist()
        return int(look_behind(self._points, self._normals, x, y, BEHIND_M, BEHIND_SLANT, self._behind))

    def _build(self) -> None:
        """Build the reference of what is seen from its place."""
        self._stale = False
        if self._place is None:
            self._reference.build(self._points)
            return
        self._hidden = self._look(self._place)
        self._reference.build(np.ascontiguousarray(self._points[~self._behind]))
