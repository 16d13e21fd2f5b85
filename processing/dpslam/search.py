"""After a loss, or at the start on a saved map: go on by the odometry until the map knows the place."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import se2
from processing.dpslam.finding import Finder
from processing.dpslam.grid import TileStore
from processing.dpslam.relocation import NOWHERE, Relocation
from processing.dpslam.sweep import Sweep
from processing.se2 import Pose

STEP_M = 0.25
STEP_RAD = 0.2
"""A scan is looked with after so much way, or turning."""


class Search:
    """Scans since the track began anew, held together by the odometry; the map stays as it is meanwhile.

    Args:
        guess: Where the odometry has the laser on the map; a first look that says the same is believed.
    """

    def __init__(self, guess: Pose | None = None) -> None:
        self._guess = guess
        self._path: list[Pose] = []
        self._finder: Finder | None = None
        self._waiting: dict[str, NDArray[Any]] | None = None

    @property
    def found(self) -> Relocation:
        """What the last look found."""
        return NOWHERE if self._finder is None else self._finder.found

    def look(self, odom_t_laser: Pose, sweep: Sweep, store: TileStore, particle: int) -> Relocation:
        """Take one more scan and, if the laser has gone on, search the map for it.

        Args:
            odom_t_laser: (3,) where the odometry has the laser.
            sweep: What it sees.
            store: The maps; they must not change while the search lasts.
            particle: Whose map is searched.
        """
        if self._finder is None:
            self._finder = Finder(store, particle)
            if self._waiting is not None:
                self._finder.restore(self._waiting)
                self._waiting = None
            if self._guess is not None:
                self._finder.expect(self._guess, odom_t_laser)
                self._guess = None
        if self._path:
            way = se2.between(self._path[-1], odom_t_laser)
            if np.hypot(way[0], way[1]) < STEP_M and abs(way[2]) < STEP_RAD:
                return self._finder.found
        self._path.append(odom_t_laser)
        return self._finder.take(np.array(self._path), sweep)

    def state(self) -> dict[str, NDArray[Any]]:
        """Return what was gathered as arrays; `from_state` takes it back."""
        gathered = self._waiting or ({} if self._finder is None else self._finder.state())
        guess = np.zeros((0, 3)) if self._guess is None else self._guess[None]
        return {"path": np.array(self._path).reshape(-1, 3), "guess": guess, **gathered}

    @classmethod
    def from_state(cls, state: dict[str, NDArray[Any]]) -> "Search":
        """Return the search whose `state` was taken."""
        search = cls(next(iter(state["guess"].copy()), None))
        search._path = list(state["path"].copy())
        gathered = {name: part for name, part in state.items() if name not in ("path", "guess")}
        search._waiting = gathered or None
        return search
