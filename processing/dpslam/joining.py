"""Two pasts become one: a drive that was found on a saved map, in the frame of that map."""

import numpy as np

from processing import se2
from processing.dpslam.memory import HEADINGS, MOST_SCANS, PLACE_M
from processing.dpslam.past import Ints, Past
from processing.dpslam.places import DOUBT
from processing.dpslam.population import ARRIVAL
from processing.se2 import Pose

FAR = 2.0
"""How well the way between two drives is known, one sigma: not at all; m, rad."""


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
