"""A mapper drawn anew from what its drives have left behind."""

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from processing.dpslam.config import DpSlamConfig
from processing.dpslam.drift import Drift
from processing.dpslam.filter import DpSlam
from processing.dpslam.judging import Judge
from processing.dpslam.memory import KeyScans
from processing.dpslam.part_judge import PartJudge
from processing.dpslam.past import Floats, Past
from processing.dpslam.population import ARRIVAL, Population
from processing.dpslam.settled import SettledMap
from processing.dpslam.sweep import Sweeper
from processing.motion import Motion
from processing.scan import Scan


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
    found = (past.relation_ends, past.relation_poses, past.relation_informations)
    drift = Drift.retold(past.covariances, past.motions, *found)
    drift.errors.rows[-1] = np.diag(ARRIVAL**2)
    drawn = SettledMap()
    drawn.rebuild(points[:settled], past.map_t_laser[:settled])
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
        "drift": drift.errors.rows,
        "flags": np.array((True, 0, settled, 0)),
        "tried_m": np.array(way_m[-1]),
        "judge": Judge(config.loops).state(),
        "part_judge": PartJudge(config.loops).state(),
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
