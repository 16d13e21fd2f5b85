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
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.filter import DpSlam
from processing.dpslam.loops import DOUBT
from processing.dpslam.memory import HEADINGS, MOST_SCANS, PLACE_M, KeyScans
from processing.dpslam.population import ARRIVAL, Population
from processing.dpslam.settled import SettledMap
from processing.dpslam.sweep import Sweeper
from processing.motion import Motion
from processing.scan import Beams, Scan
from processing.se2 import Pose

Ints = NDArray[np.int64]
Floats = NDArray[np.float64]
_BEAMS = tuple(field.name for field in fields(Beams))
STEP = np.array((0.02, 0.02, 0.01))
"""How well the way between key scans is taken to be known where nobody noted it, one sigma; m, m, rad."""
FAR = 2.0
"""The same of the way between two drives, which nobody knows; m, rad."""


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


def rebuild(
    past: Past,
    config: DpSlamConfig | None = None,
    seed: int = 0,
    *,
    going_on: bool = False,
    fixed: bool = False,
) -> DpSlam:
    """Return a mapper with this past: its map drawn anew, shared by all particles.

    Args:
        past: What was seen.
        config: Of the mapper; it need not be that of the past.
        seed: Of its random numbers.
        going_on: The next scan follows the last one, which must be a key scan; else it belongs to another
            drive, and `find_itself` says that it may be anywhere.
        fixed: The map stays as it is, see `DpSlam.fixed`; no loops are closed then.
    """
    config = config or DpSlamConfig()
    if fixed:
        config = replace(config, close_loops=False)
    key_state: dict[str, NDArray[Any]] = {
        "ranges_m": past.ranges_m,
        "numbers": past.numbers,
        "counts": past.counts,
        "twists": past.twists,
        "places": past.places,
    }
    scans = KeyScans()
    scans.restore(key_state)
    people = Population(config, seed)
    people.keys = len(past.keys)
    people.relive(past.map_t_laser, scans, past.scanner)
    parts: dict[str, dict[str, NDArray[Any]]] = {
        "people": people.state(),
        "scans": key_state,
        "trail": {
            "stamps_ns": past.stamps_ns,
            "odom_t_laser": past.odom_t_laser,
            "keys": past.keys,
            "breaks": past.breaks,
        },
    }
    if config.close_loops:
        parts["loops"] = _loops(past, config)
    last = past.odom_t_laser[past.keys[-1]]
    own = {
        "key_odom_t_laser": last,
        "odom_t_laser": past.odom_t_laser[-1],
        "covariance": np.zeros((3, 3)),
        "particles": np.array(config.particles),
        "strange": np.array(not going_on),
        "fixed": np.array(fixed),
        "beams": past.beams,
    }
    named = {f"{part}.{name}": value for part, arrays in parts.items() for name, value in arrays.items()}
    return DpSlam.from_state(own | named, config)


def joined(first: Past, second: Past, key: int, map_t_key: Pose) -> Past:
    """Return the past of both, in the frame of the first.

    Args:
        first: What was there.
        second: A drive, or several, of the same scanner.
        key: The key scan of the second that was found on the map of the first,
        map_t_key: (3,) there.

    Raises:
        ValueError: the scanners differ.
    """
    if first.beams[0] != second.beams[0]:
        raise ValueError(f"scans of {second.beams[0]:g} beams, must be {first.beams[0]:g} as on the map")
    n, k = len(first.stamps_ns), len(first.keys)
    map_t_second = se2.compose(map_t_key, se2.invert(second.map_t_laser[key]))
    path = np.vstack((first.map_t_laser, se2.compose(map_t_second, second.map_t_laser)))
    off = np.hypot(*(first.map_t_laser[:, :2] - map_t_key[:2]).T)
    off += 0.5 * np.abs(se2.wrap(first.map_t_laser[:, 2] - map_t_key[2]))
    near = int(off.argmin())
    motions, covariances = second.motions.copy(), second.covariances.copy()
    motions[0], covariances[0] = se2.between(path[k - 1], path[k]), np.diag((FAR**2,) * 3)
    places, dropped = _kept(first.places, second.places, path, k)
    counts = np.concatenate((first.counts, second.counts))
    rays = np.repeat(np.isin(np.arange(len(counts)), dropped), counts)
    counts[dropped] = 0
    return Past(
        beams=first.beams,
        stamps_ns=np.concatenate((first.stamps_ns, second.stamps_ns)),
        odom_t_laser=np.vstack((first.odom_t_laser, second.odom_t_laser)),
        drives=np.concatenate((first.drives, second.drives + n)),
        breaks=np.concatenate((first.breaks, (n,), second.breaks + n)).astype(np.int64),
        keys=np.concatenate((first.keys, second.keys + n)),
        map_t_laser=path,
        ranges_m=np.concatenate((first.ranges_m, second.ranges_m))[~rays],
        numbers=np.concatenate((first.numbers, second.numbers))[~rays],
        counts=counts,
        twists=np.vstack((first.twists, second.twists)),
        places=places,
        motions=np.vstack((first.motions, motions)),
        covariances=np.concatenate((first.covariances, covariances)),
        relation_ends=np.vstack((first.relation_ends, second.relation_ends + k, ((near, k + key),))),
        relation_poses=np.vstack(
            (first.relation_poses, second.relation_poses, se2.between(first.map_t_laser[near], map_t_key))
        ),
        relation_informations=np.concatenate(
            (first.relation_informations, second.relation_informations, [np.diag(1.0 / ARRIVAL**2)])
        ),
        relation_doubts=np.concatenate((first.relation_doubts, second.relation_doubts, (DOUBT,))),
    )


def _kept(first: Ints, second: Ints, path: Pose, keys: int) -> tuple[Ints, Ints]:
    """Return the places of both, the second's along the joined path, and the key scans that are too many."""
    kept: dict[tuple[int, int, int], list[int]] = {}
    for x, y, heading, key in first.tolist():
        kept.setdefault((x, y, heading), []).append(key)
    for key in (second[:, 3] + keys).tolist():
        x, y, yaw = path[key].tolist()
        heading = int(np.floor(yaw / (2.0 * np.pi) * HEADINGS)) % HEADINGS
        kept.setdefault((int(np.floor(x / PLACE_M)), int(np.floor(y / PLACE_M)), heading), []).append(key)
    dropped = [key for there in kept.values() for key in there[:-MOST_SCANS]]
    places = [(*place, key) for place, there in kept.items() for key in there[-MOST_SCANS:]]
    return np.array(places, dtype=np.int64).reshape(-1, 4), np.array(dropped, dtype=np.int64)


def _loops(past: Past, config: DpSlamConfig) -> dict[str, NDArray[Any]]:
    """Return the state of loops that have seen all of this; every earlier drive is settled."""
    sweeper = Sweeper(past.scanner, config.points, config.range_max_m)
    points = []
    ends = np.cumsum(past.counts)
    for key, end in enumerate(ends.tolist()):
        part = slice(end - int(past.counts[key]), end)
        points.append(_points(sweeper, past.ranges_m[part], past.numbers[part], past.twists[key]))
    steps = np.hypot(past.motions[:, 0], past.motions[:, 1])
    steps[0] = 0.0
    starts = np.searchsorted(past.keys, past.drives)
    steps[starts[(starts > 0) & (starts < len(steps))]] += 2.0 * config.loops.reach_m
    way_m = np.cumsum(steps)
    settled = int(np.searchsorted(way_m, way_m[-1] - config.loops.reach_m))
    drawn = SettledMap()
    placed = [se2.transform(past.map_t_laser[key], points[key]) for key in range(settled)]
    drawn.rebuild(np.vstack((np.zeros((0, 2)), *placed)))
    return {
        "path": past.map_t_laser,
        "points": np.vstack((np.zeros((0, 2)), *points)),
        "counts": np.array([len(part) for part in points], dtype=np.int64),
        "motions": past.motions,
        "covariances": past.covariances,
        "way_m": way_m,
        "place_ends": past.relation_ends,
        "place_poses": past.relation_poses,
        "place_informations": past.relation_informations,
        "place_doubts": past.relation_doubts,
        "drift": np.diag(ARRIVAL**2),
        "flags": np.array((True, 0, settled, 0)),
        "tried_m": np.array(way_m[-1]),
        "pending": np.full(4, np.nan),
        **{f"map.{name}": part for name, part in drawn.state().items()},
    }


def _points(
    sweeper: Sweeper, ranges_m: NDArray[np.float32], numbers: NDArray[np.uint16], twist: Floats
) -> Floats:
    """Return the points that the mapper took from a key scan; none of one that was not kept."""
    if len(numbers) == 0:
        return np.zeros((0, 2))
    full = np.full(sweeper.beams.count, np.nan, dtype=np.float32)
    full[numbers] = ranges_m
    motion = Motion(stamp_ns=0, odom_t_laser=np.zeros(3), covariance=np.zeros((3, 3)), twist=twist)
    return sweeper.take(Scan(0, full, sweeper.beams), motion).points
