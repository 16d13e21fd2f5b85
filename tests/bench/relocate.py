"""Re-finding on a saved map: from random starts, how often, how soon, and never in a wrong place.

    python tests/bench/relocate.py demo
    python tests/bench/relocate.py ../shared/data/intel.clf.bz2 ../shared/data/fr079.clf.bz2

Of a log, the first half is the saved map and the second half is driven anew, each time from another scan on,
with an odometry that begins there. The truth is the path of a map of the whole log, whose frame the first
half shares but for what later loops moved. The demo is a simulated building: its truth is exact, and the
drives on the saved map have noise of their own.
"""

import argparse
import itertools
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[2]))

from drivers.world import Urg04lx, demo_building, simulate_scans
from processing import se2
from processing.dpslam.past import Past, past_of
from processing.dpslam.resume import Returning
from processing.odometry import LaserOdometry, OdometryConfig
from processing.scan import Beams, Scan
from processing.slam import Slam
from runtime.nodes.log_scans import scans_of

HEAD = """\
| course | starts | found | median s (m) | worst s (m) | error | wrong | equal: starts, looks | a look, ms |
|---|---|---|---|---|---|---|---|---|"""
WRONG_M, WRONG_RAD = 0.5, 0.2
MAPPED_M = 1.0
"""Starts are drawn where the saved map's path came so near."""
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
    beams = Beams(
        count=laser.beams,
        angle_min_rad=laser.angle_min_rad,
        angle_increment_rad=laser.angle_increment_rad,
        time_increment_s=laser.time_increment_s,
        period_s=laser.period_s,
        range_min_m=laser.range_min_m,
        range_max_m=laser.range_max_m,
    )

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
    near = np.array(
        [np.hypot(*(past.map_t_laser[:, :2] - pose[:2]).T).min() < MAPPED_M for pose in path[middle:]]
    )
    last = len(kept) - middle - round(MOST_S / kept[0].beams.period_s)
    return Course(log.name, past, kept[middle:], path[middle:], np.flatnonzero(near[:last]))


def measure(course: Course, starts: int, seed: int, each: bool) -> None:
    """Print one row."""
    chosen = np.random.default_rng(seed).choice(course.starts, starts, replace=False)
    found_s, way_m, errors, looks_ms = [], [], [], []
    wrong = refused = looks = equals = 0
    for start in sorted(chosen.tolist()):
        odometry = LaserOdometry(OdometryConfig(), seed)
        robot = Returning(course.past, seed=seed)
        period_s = course.scans[0].beams.period_s
        found, way, worst, refusals = None, 0.0, 0.0, 0
        scans = itertools.islice(course.scans, start, start + round((MOST_S + ON_S) / period_s))
        for number, scan in enumerate(scans):
            match = odometry.step(scan)
            before, began = robot.finder.looks, time.thread_time()
            step = robot.step(scan, match.motion)
            if robot.finder.looks > before:
                looks_ms.append(1e3 * (time.thread_time() - began))
                refusals += len(step.places) > 1
            if number:
                moved = course.map_t_laser[start + number] - course.map_t_laser[start + number - 1]
                way += float(np.hypot(*moved[:2])) if found is None else 0.0
            if robot.found:
                off = se2.between(course.map_t_laser[start + number], step.map_t_laser)
                if found is None:
                    found = number * period_s
                    errors.append(float(np.hypot(off[0], off[1])))
                worst = max(worst, float(np.hypot(off[0], off[1])) / WRONG_M, abs(float(off[2])) / WRONG_RAD)
                if number * period_s > found + ON_S:
                    break
            elif number * period_s > MOST_S:
                break
        looks, equals = looks + robot.finder.looks, equals + refusals
        refused += refusals > 0
        wrong += worst > 1.0
        if found is not None:
            found_s.append(found)
            way_m.append(way)
        if each:
            told = f"found {found} s, {way:.1f} m, worst {worst:.2f} of wrong, {refusals} refusals"
            print(f"<!-- start {start}: {told} -->", flush=True)
    if not found_s:
        print(
            f"| {course.name} | {starts} | 0 | | | | {wrong} | {refused} of {starts}, {equals} of {looks} | |"
        )
        return
    print(
        f"| {course.name} | {starts} | {len(found_s)} | {np.median(found_s):.1f} ({np.median(way_m):.1f})"
        f" | {max(found_s):.1f} ({max(way_m):.1f}) | {np.mean(errors):.3f} m | {wrong}"
        f" | {refused} of {starts}, {equals} of {looks}"
        f" | {np.median(looks_ms):.0f} (worst {max(looks_ms):.0f}) |",
        flush=True,
    )


if __name__ == "__main__":
    main()
