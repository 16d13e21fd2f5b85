"""The scans between the key scans: a pose for every scan from the poses of the key scans and the odometry."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import se2
from processing.growing import Growing
from processing.se2 import Pose


class Trail:
    """Every scan's stamp and odometry, and which of them are key scans."""

    def __init__(self) -> None:
        self._stamps_ns, self._odom_t_laser = Growing(dtype=np.int64), Growing((3,))
        self._keys = Growing(dtype=np.int64)
        self._breaks: list[int] = []

    def add(self, stamp_ns: int, odom_t_laser: Pose) -> None:
        """Append one scan."""
        self._stamps_ns.append(stamp_ns)
        self._odom_t_laser.append(odom_t_laser)

    def mark_key(self) -> None:
        """Make the newest scan a key scan."""
        self._keys.append(self.scans - 1)

    def break_off(self) -> None:
        """Say that the odometry tells nothing of the way to the newest scan: the track was lost before it."""
        self._breaks.append(self.scans - 1)

    @property
    def scans(self) -> int:
        """Number of all scans."""
        return len(self._stamps_ns)

    @property
    def keys(self) -> int:
        """Number of the key scans."""
        return len(self._keys)

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """(N,) stamps of all scans, in the order in which they came."""
        return self._stamps_ns.rows.copy()

    def stamps_of(self, scans: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the stamps (N,) of some scans by their numbers (N,)."""
        return np.asarray(self._stamps_ns.rows[scans])

    @property
    def odom_t_laser(self) -> Pose:
        """(N, 3) of all scans by the odometry."""
        return self._odom_t_laser.rows.copy()

    def lay(self, map_t_keys: Pose, scans: NDArray[np.int64] | None = None) -> Pose:
        """Return map_t_laser (N, 3) of all scans, or of some.

        Between two key scans the odometry gives the shape, and what it misses at the second is spread evenly
        over the scans between; after the last key scan the odometry goes on alone.

        Args:
            map_t_keys: (K, 3) poses of the key scans.
            scans: (N,) numbers of those that are wanted; None for all.
        """
        odom = self._odom_t_laser.rows
        scans = np.arange(self.scans) if scans is None else scans
        own = odom[scans]
        if self.keys == 0:
            return own
        keys = self._keys.rows
        before = np.maximum(np.searchsorted(keys, scans, side="right") - 1, 0)
        after = np.minimum(before + 1, self.keys - 1)
        key_t_scan = se2.between(odom[keys[before]], own)
        key_t_next = se2.between(odom[keys[before]], odom[keys[after]])
        missed = se2.between(key_t_next, se2.between(map_t_keys[before], map_t_keys[after]))
        span = np.maximum(keys[after] - keys[before], 1)
        torn = np.diff(
            np.searchsorted(self._breaks, np.stack((keys[before], keys[after])), side="right"), axis=0
        )[0]
        share = np.where((after > before) & (torn == 0), (scans - keys[before]) / span, 0.0)[:, None]
        laid = se2.compose(map_t_keys[before], se2.compose(key_t_scan, missed * share))
        # From where the track was lost up to where it was found again, the way is known backwards.
        lost = np.searchsorted(self._breaks, scans, side="right") > np.searchsorted(
            self._breaks, keys[before], side="right"
        )
        back = lost & (after > before)
        laid[back] = se2.compose(map_t_keys[after[back]], se2.between(odom[keys[after[back]]], own[back]))
        return laid

    def state(self) -> dict[str, NDArray[Any]]:
        """Return what was added; `restore` takes it back."""
        return {
            "stamps_ns": self.stamps_ns,
            "odom_t_laser": self.odom_t_laser,
            "keys": self._keys.rows.copy(),
            "breaks": np.array(self._breaks, dtype=np.int64),
        }

    def restore(self, state: dict[str, NDArray[Any]]) -> None:
        """Become the trail whose `state` was taken."""
        self._stamps_ns.replace(state["stamps_ns"])
        self._odom_t_laser.replace(state["odom_t_laser"])
        self._keys.replace(state["keys"])
        self._breaks = state["breaks"].tolist()
