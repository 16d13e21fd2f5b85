"""After the track is lost, or at the start on a saved map: look, remember the last metres, look again."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import se2
from processing.dpslam.grid import TileStore
from processing.dpslam.relocation import NOWHERE, Relocation, relocate
from processing.dpslam.sweep import Sweep
from processing.se2 import Pose

EVERY_M = 0.5
"""Way between two looks."""
STRETCH = 12
"""Sweeps that are laid together for a look: where one room looks like another, the way there may not."""


class Search:
    """The sweeps since the track was lost, held together by the odometry, which goes on from anywhere."""

    def __init__(self, guess: Pose | None) -> None:
        self._guess = guess
        self._sweeps: list[tuple[Pose, NDArray[np.float64]]] = []
        self._looked_at: Pose | None = None
        self.found: Relocation = NOWHERE
        """What the last look found."""

    def look(self, odom_t_laser: Pose, sweep: Sweep, store: TileStore, particle: int) -> Relocation:
        """Take one more sweep and, if the laser has gone on since the last look, search the map for it.

        Args:
            odom_t_laser: (3,) where the odometry has the laser.
            sweep: What it sees.
            store: The maps.
            particle: Whose map is searched.
        """
        self._sweeps.append((odom_t_laser, sweep.points))
        del self._sweeps[:-STRETCH]
        if self._looked_at is not None:
            way = se2.between(self._looked_at, odom_t_laser)
            if np.hypot(way[0], way[1]) < EVERY_M and abs(way[2]) < 1.0:
                return self.found
        self._looked_at = odom_t_laser
        points = np.vstack(
            [se2.transform(se2.between(odom_t_laser, pose), seen) for pose, seen in self._sweeps]
        )
        self.found = NOWHERE
        if self._guess is not None:
            # Near where it was lost, once: farther on the guess is worth nothing.
            self.found = relocate(store, particle, points, sweep.rays, self._guess)
            self._guess = None
        if self.found.map_t_laser is None:
            self.found = relocate(store, particle, points, sweep.rays)
        return self.found

    def state(self) -> dict[str, NDArray[Any]]:
        """Return what was gathered as arrays; `from_state` takes it back."""
        none = np.zeros((0, 3))
        return {
            "guess": none if self._guess is None else self._guess[None],
            "looked_at": none if self._looked_at is None else self._looked_at[None],
            "poses": np.array([pose for pose, _ in self._sweeps]).reshape(-1, 3),
            "counts": np.array([len(points) for _, points in self._sweeps], dtype=np.int64),
            "points": np.vstack((np.zeros((0, 2)), *(points for _, points in self._sweeps))),
            "places": np.array(self.found.places).reshape(-1, 3),
            "fits": np.array(self.found.fits, dtype=np.float64),
        }

    @classmethod
    def from_state(cls, state: dict[str, NDArray[Any]]) -> "Search":
        """Return the search whose `state` was taken."""
        search = cls(next(iter(state["guess"].copy()), None))
        search._looked_at = next(iter(state["looked_at"].copy()), None)
        parts = np.split(state["points"], np.cumsum(state["counts"]))
        search._sweeps = [
            (pose.copy(), part.copy()) for pose, part in zip(state["poses"], parts, strict=False)
        ]
        # A search that goes on has found no single place.
        search.found = Relocation(None, tuple(state["places"].copy()), tuple(state["fits"].tolist()))
        return search
