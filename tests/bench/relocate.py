"""Re-finding on a saved map: from random starts, how often, how soon, and never in a wrong place.

    python tests/bench/relocate.py demo
    python tests/bench/relocate.py ../shared/data/intel.clf.bz2 ../shared/data/fr079.clf.bz2

Of a log, the first half is the saved map and the second half is driven anew, each time from another scan on,
with an odometry that begins there. The truth is the path of a map of the whole log, whose frame the first
half shares but for what later loops moved. The demo is a simulated building: its truth is exact, and the
drives on the saved map have noise of their own.

Columns: time and way until found; error at that moment; `wrong`: found somewhere else; `left`: found rightly
and somewhere else within the next five seconds, which the odometry has to answer for; `equal`: starts and
looks at which several places fitted equally; time of a look (worst).
"""

import argparse
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[2]))

from drivers.world import Urg04lx, demo_building, simulate_scans
from processing import se2
from processing.dpslam.past import Past, past_of
from processing.dpslam.redrawing import rebuild
from processing.dpslam.relocation import walls_of
from processing.dpslam.resume import Returning
from processing.odometry import LaserOdometry, OdometryConfig
from processing.scan import Scan, end_points
from processing.slam import Slam
from processing.wide_match import build_field
from runtime.nodes.log_scans import scans_of
from tests.lasers import beams_of_laser

HEAD = """\
| course | starts | found | median s (m) | worst s (m) | error, m (worst) | wrong | left | equal | look, ms |
|---|---|---|---|---|---|---|---|---|---|"""
WRONG_M, WRONG_RAD = 0.5, 0.2
KNOWN = 0.5
"""Starts are drawn where this share of what the laser sees lies on walls of the saved map."""
MOST_S = 60.0
"""A drive that is not found after so long counts as not found."""
ON_S = 5.0
"""So long it is followed after it was found."""


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """A saved map, and scans with their true poses in its frame."""

    name: str
    past: Past
    scans: list[Scan]
    map_t_laser: NDArray[np.float64]
    """(N, 3)"""
    starts: NDArray[np.int64]
    """Scans from which a drive may begin."""


def main() -> None:
    """Measure what the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("courses", nargs="+", help="demo, or a log")
    parser.add_argument("--starts", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--each", action="store_true", help="also a line for each start")
    args = parser.parse_args()
    print(HEAD)
    for name in args.courses:
        course = demo(args.seed) if name == "demo" else halves(Path(name), args.seed)
        measure(course, args.starts, args.seed, args.each)


def demo(seed: int) -> Course:
    """Map the demo building once; drive it again with other noise."""
    laser = Urg04lx()
    beams = beams_of_laser(laser)

    def drive(noise: int) -> Iterator[tuple[Scan, NDArray[np.float64]]]:
        for stamp_ns, ranges_m, pose in simulate_scans(demo_building(), laser=laser, seed=noise):
            yield Scan(stamp_ns, ranges_m, beams), pose

    slam, start = Slam(seed=seed), None
    for scan, pose in drive(seed):
        start = pose if start is None else start
        slam.step(scan)
    slam.finish()
    scans, poses = zip(*drive(seed + 1), strict=True)
    truth = se2.between(np.broadcast_to(start, (len(poses), 3)), np.array(poses))
    last = len(scans) - round(MOST_S / beams.period_s)
    return Course("demo building", past_of(slam.mapping), list(scans), truth, np.arange(last))


def halves(log: Path, seed: int) -> Course:
    """Map the first half of a log, and all of it for the truth."""
    _, scans = scans_of(log)
    kept = list(scans)
    half, whole = Slam(seed=seed), Slam(seed=seed)
    middle = len(kept) // 2
    for number, scan in enumerate(kept):
        if number < middle:
            half.step(scan)
        whole.step(scan)
    half.finish()
    whole.finish()
    past = past_of(half.mapping)
    path = whole.trajectory()[1]
    bent = np.abs(se2.between(half.trajectory()[1], path[:middle]))
    print(f"<!-- {log.name}: the two maps differ by up to {np.hypot(bent[:, 0], bent[:, 1]).max():.2f} m -->")
    last = len(kept) - round(MOST_S / kept[0].beams.period_s)
    known = known_share(past, kept[middle:last], path[middle:last])
    return Course(log.name, past, kept[middle:], path[middle:], np.flatnonzero(known >= KNOWN))


def known_share(past: Past, scans: list[Scan], poses: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return which share of each scan's end points lies on a wall of the map, at the true pose."""
    store = rebuild(past).population.store
    likely = build_field(walls_of(store, 0), 0.05, 0.15, 20.0)
    shares = []
    for scan, pose in zip(scans, poses, strict=True):
        points = se2.transform(pose, end_points(scan, np.zeros(3), range_max_m=15.0)[0])
        col, row = np.floor((points - likely.origin_m) / likely.resolution_m).astype(np.int64).T
        rows, cols = likely.levels[0].shape
        inside = (row >= 0) & (row < rows) & (col >= 0) & (col < cols)
        on_wall = likely.levels[0][row[inside], col[inside]] > 0.3
        shares.append(float(on_wall.sum()) / max(len(points), 1))
    return np.array(shares)


def measure(course: Course, starts: int, seed: int, each: bool) -> None:
    """Print one row."""
    chosen = np.random.default_rng(seed).choice(course.starts, starts, replace=False)
    tries = [drive(course, start, seed) for start in sorted(chosen.tolist())]
    found = [one for one in tries if one.found_s is not None]
    soon = late = error = "-"
    if found:
        times, ways = [one.found_s for one in found], [one.way_m for one in found]
        soon = f"{np.median(times):.1f} ({np.median(ways):.1f})"
        late = f"{max(times):.1f} ({max(ways):.1f})"
        error = f"{np.mean([one.error_m for one in found]):.3f} ({max(one.error_m for one in found):.3f})"
    wrong, left = sum(one.wrong for one in found), sum(one.left for one in found)
    looks_ms = [took for one in tries for took in one.looks_ms]
    refused, refusals = sum(one.refusals > 0 for one in tries), sum(one.refusals for one in tries)
    if each:
        for one in tries:
            print(f"<!-- {one} -->")
    print(
        f"| {course.name} | {starts} | {len(found)} | {soon} | {late} | {error} | {wrong} | {left}"
        f" | {refused}, {refusals} of {len(looks_ms)} | {np.median(looks_ms):.0f} ({max(looks_ms):.0f}) |",
        flush=True,
    )


@dataclass(slots=True)
class Try:
    """What became of one start."""

    start: int
    found_s: float | None = None
    way_m: float = 0.0
    error_m: float = 0.0
    wrong: bool = False
    """Whether it was found somewhere else."""
    left: bool = False
    """Whether it was found rightly, and was somewhere else within the next seconds."""
    refusals: int = 0
    looks_ms: list[float] = field(default_factory=list, repr=False)


def drive(course: Course, start: int, seed: int) -> Try:
    """Drive from one start until found, and a little farther."""
    odometry = LaserOdometry(OdometryConfig(), seed)
    robot = Returning(course.past, seed=seed)
    period_s = course.scans[0].beams.period_s
    one = Try(start)
    for number in range(round((MOST_S + ON_S) / period_s)):
        if start + number == len(course.scans):
            break
        scan, truth = course.scans[start + number], course.map_t_laser[start + number]
        match = odometry.step(scan)
        looks, began = robot.finder.looks, time.thread_time()
        step = robot.step(scan, match.motion)
        if robot.finder.looks > looks:
            one.looks_ms.append(1e3 * (time.thread_time() - began))
            one.refusals += len(step.places) > 1
        off = se2.between(truth, step.map_t_laser)
        off_m = float(np.hypot(off[0], off[1]))
        astray = off_m > WRONG_M or abs(float(off[2])) > WRONG_RAD
        if one.found_s is not None:
            one.left = one.left or (astray and not one.wrong)
            if number * period_s > one.found_s + ON_S:
                break
            continue
        if number:
            moved = truth - course.map_t_laser[start + number - 1]
            one.way_m += float(np.hypot(moved[0], moved[1]))
        if robot.found:
            one.found_s, one.error_m, one.wrong = number * period_s, off_m, astray
        elif number * period_s > MOST_S:
            break
    return one


if __name__ == "__main__":
    main()
