"""What a drive leaves behind: enough to draw its map again and to go on from it, in plain arrays.

Not the particles but what they were made of: the key scans that are kept, the path they lie on, and the
relations that hold it. A map drawn from them is the best particle's, and no version of the program has to
know how another one laid its memory out.
"""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing import se2
from processing.dpslam.filter import DpSlam
from processing.scan import Beams

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
_BEAMS = tuple(field.name for field in fields(Beams))
STEP = np.array((0.02, 0.02, 0.01))
"""How well the way between key scans is taken to be known where nobody noted it, one sigma; m, m, rad."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Past:
    """N scans, K of them key scans, of one or more drives in one map frame; R relations."""

    beams: Floats
    """The scanner: the fields of `Beams` in their order."""
    stamps_ns: Ints
    """(N,)"""
    odom_t_laser: Floats
    """(N, 3) each drive has an odometry frame of its own."""
    drives: Ints
    """(D,) number of the first scan of each drive."""
    breaks: Ints
    """(B,) scans to which the odometry does not tell the way."""
    keys: Ints
    """(K,) which scans are key scans."""
    map_t_laser: Floats
    """(K, 3) the path."""
    ranges_m: NDArray[np.float32]
    """Of every ray of every key scan that is kept, one after the other."""
    numbers: NDArray[np.uint16]
    """Which rays of the scanner these are."""
    counts: Ints
    """(K,) rays of each key scan; 0 where newer ones stand for it."""
    twists: Floats
    """(K, 3) velocity of the laser during each."""
    places: Ints
    """(M, 4) square x, y and heading, and the key scan that is kept of it."""
    motions: Floats
    """(K, 3) from the key scan before."""
    covariances: Floats
    """(K, 3, 3) of these, in the frame of the later one."""
    relation_ends: Ints
    """(R, 2) key scans of which the later one was found to lie on what the earlier one saw."""
    relation_poses: Floats
    """(R, 3) the later one seen from the earlier one."""
    relation_informations: Floats
    """(R, 3, 3)"""
    relation_doubts: Floats
    """(R,) chi-square at which each is doubted; 0 for never."""

    def __post_init__(self) -> None:
        n, k, r = len(self.stamps_ns), len(self.keys), len(self.relation_ends)
        shapes = {
            "beams": (len(_BEAMS),), "odom_t_laser": (n, 3), "map_t_laser": (k, 3), "counts": (k,),
            "twists": (k, 3), "motions": (k, 3), "covariances": (k, 3, 3), "relation_ends": (r, 2),
            "relation_poses": (r, 3), "relation_informations": (r, 3, 3), "relation_doubts": (r,),
            "numbers": self.ranges_m.shape, "places": (len(self.places), 4),
        }  # fmt: skip
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise ValueError(f"{name} has shape {getattr(self, name).shape}, must be {shape}")
        if k == 0:
            raise ValueError("0 key scans, must be at least 1")
        if self.counts.min() < 0 or self.counts.sum() != len(self.ranges_m):
            raise ValueError(f"counts sum to {self.counts.sum()}, must be {len(self.ranges_m)}")
        for name, numbers, end in (("keys", self.keys, n), ("drives", self.drives, n)):
            if (np.diff(numbers) <= 0).any() or numbers.min(initial=0) < 0 or numbers.max(initial=0) >= end:
                raise ValueError(f"{name} must rise within [0, {end})")
        ends = np.concatenate((self.relation_ends.ravel(), self.places[:, 3]))
        if ends.min(initial=0) < 0 or ends.max(initial=0) >= k:
            raise ValueError(f"relation_ends and places name key scan {ends.max()}, must be in [0, {k})")
        if self.numbers.max(initial=0) >= self.beams[0]:
            raise ValueError(f"ray {self.numbers.max()}, must be under {self.beams[0]:g}")

    @property
    def scanner(self) -> Beams:
        """The rays of the scanner."""
        count, *angles = self.beams.tolist()
        return Beams(count=int(count), **dict(zip(_BEAMS[1:], angles, strict=True)))

    def unseen(self) -> "Past":
        """Return the same path of which nothing was seen."""
        return replace(
            self,
            ranges_m=self.ranges_m[:0],
            numbers=self.numbers[:0],
            counts=np.zeros_like(self.counts),
            places=self.places[:0],
        )

    def arrays(self) -> dict[str, NDArray[Any]]:
        """Return everything under its name; `Past(**arrays)` takes it back."""
        return {field.name: getattr(self, field.name) for field in fields(self)}


def past_of(slam: DpSlam, drives: Ints | None = None) -> Past:
    """Return what a mapper has seen, along its best particle's path.

    Args:
        slam: The mapper; `finish` it first.
        drives: (D,) number of the first scan of each drive, where there is more than one.

    Raises:
        ValueError: it has not mapped a single scan.
    """
    state = slam.state()
    if slam.population.keys == 0:
        raise ValueError("0 key scans, must be at least 1")
    path = slam.population.path
    looped = slam.loops is not None
    steps = np.vstack((np.zeros(3), se2.between(path[:-1], path[1:])))
    known = np.broadcast_to(np.diag(STEP**2), (len(path), 3, 3)).copy()
    return Past(
        beams=state["beams"].astype(np.float64),
        stamps_ns=state["trail.stamps_ns"],
        odom_t_laser=state["trail.odom_t_laser"],
        drives=np.zeros(1, dtype=np.int64) if drives is None else drives,
        breaks=state["trail.breaks"],
        keys=state["trail.keys"],
        map_t_laser=path,
        ranges_m=state["scans.ranges_m"],
        numbers=state["scans.numbers"],
        counts=state["scans.counts"],
        twists=state["scans.twists"],
        places=state["scans.places"],
        motions=state["loops.motions"] if looped else steps,
        covariances=state["loops.covariances"] if looped else known,
        relation_ends=state["loops.place_ends"] if looped else np.zeros((0, 2), dtype=np.int64),
        relation_poses=state["loops.place_poses"] if looped else np.zeros((0, 3)),
        relation_informations=state["loops.place_informations"] if looped else np.zeros((0, 3, 3)),
        relation_doubts=state["loops.place_doubts"] if looped else np.zeros(0),
    )
