"""How good the maps are at many seeds, on logs, on variations of them, and in simulated buildings.

    python tests/bench/slam_seeds.py [COURSE ...] [--seeds 10] [--workers 2] [--set NAME=VALUE ...]

Whole pipeline, laser alone, default settings. Relations: mean error, m and degrees. Simulated: rms error of
position and mean of rotation after the best rigid alignment. A map is good if its mean is within the bound of
the course and no single error is above five times that bound or 0.3 m, whichever is greater.

A variation of a log is another log with the same truth: `backwards` (the film from its end, in a mirror),
`near` (a laser that sees 8 m), `halved` (every second ray), `patchy` (four tenths of the rays of each scan
come back with nothing), `thinned` (every second scan), `holed` (twelve times a second is missing), `later`
(from its middle on). Of a `floor`, and of a `campus`, every seed is another building.
"""

import argparse
import json
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from floor_plans import CAMPUS, crowded, floor_plan
from odometry_courses import Course, beams_of_laser, logged

from drivers import world
from drivers.world.drive import simulate_scans
from processing.evaluation import absolute_errors, relation_errors
from processing.scan import Scan
from processing.se2 import Pose, compose, invert
from processing.slam import Slam, SlamConfig
from runtime.nodes.log_scans import by_stamps

NEAR_M = 8.0
DARK_SHARE = 0.4
UNSTEADY = 0.2
"""By so much slower at most is a robot driven whose driver does not keep its speed."""
HOLES, HOLE = 12, 5
"""So many holes of so many scans, at random places."""
LARGEST_SHARE, LARGEST_M = 5.0, 0.3
"""Beyond what a single error makes a map broken."""


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """Scans of a way, whose truth is either poses or pairs of scans with a relation."""

    scans: list[Scan]
    bound_m: float
    truth: Pose | None = None
    """(N, 3) world_t_laser."""
    pairs: np.ndarray | None = None
    """(K, 2) numbers of scans, and"""
    a_t_b: Pose | None = None
    """(K, 3) the one seen from the other, of the base."""
    base_t_laser: Pose | None = None


def _simulated(building: Callable, bound_m: float, laser: Callable = world.Urg04lx, **drive) -> Callable:
    def make(seed: int) -> Drive:
        # The noise of the drive goes with the seed, too: ten drives, not one mapped ten times.
        sensor = laser()
        records = list(simulate_scans(building(), laser=sensor, seed=seed, **drive))
        beams = beams_of_laser(sensor)
        scans = [Scan(stamp_ns, ranges_m, beams) for stamp_ns, ranges_m, _ in records]
        return Drive(scans, bound_m, truth=np.array([pose for *_, pose in records]))

    return make


def _floor(laser: Callable, people: int, bound_m: float, **drive) -> Callable:
    """Another building and another way with each seed."""

    def make(seed: int) -> Drive:
        building, sensor = floor_plan(seed), laser()
        looking = crowded(sensor, building, people, seed) if people else sensor
        records = list(simulate_scans(building, laser=looking, seed=seed, **drive))
        beams = beams_of_laser(sensor)
        scans = [Scan(stamp_ns, ranges_m, beams) for stamp_ns, ranges_m, _ in records]
        return Drive(scans, bound_m, truth=np.array([pose for *_, pose in records]))

    return make


def _dim() -> world.Spinning:
    """A laser as the cheapest are: it sees half as far, and is half as good again."""
    return world.Spinning(range_max_m=6.0, noise_m=0.03)


def _campus(unsteady: float = 0.0) -> Callable:
    """A long way through long corridors: another building with each seed."""

    def make(seed: int) -> Drive:
        drive = {"speed_mps": 0.8, "turn_rate_radps": 1.0, "unsteady": unsteady}
        return _simulated(lambda: floor_plan(seed, 1200.0, CAMPUS), 0.2, world.Sick, **drive)(seed)

    return make


def _with_relations(course: Course, bound_m: float) -> Drive:
    relations = course.relations
    number = {}
    for index, scan in enumerate(course.scans):
        number.setdefault(round(scan.stamp_ns / 1000), index)
    ends = [
        [number.get(round(stamp / 1000), -1) for stamp in stamps]
        for stamps in (relations.stamps_a_ns, relations.stamps_b_ns)
    ]
    pairs = np.array(ends).T
    kept = (pairs >= 0).all(axis=1)
    return Drive(
        course.scans,
        bound_m,
        pairs=pairs[kept],
        a_t_b=relations.a_t_b[kept],
        base_t_laser=course.base_t_laser,
    )


def _backwards(drive: Drive) -> Drive:
    """Run the film backwards, in a mirror: the mirror keeps the order in which a sweep's rays are taken."""
    flip = np.array((1.0, -1.0, -1.0))
    beams = drive.scans[0].beams
    last_rad = beams.angle_min_rad + (beams.count - 1) * beams.angle_increment_rad
    beams = replace(beams, angle_min_rad=-last_rad)
    steps = [b.stamp_ns - a.stamp_ns for a, b in pairwise(drive.scans)][::-1]
    stamps = drive.scans[0].stamp_ns + np.concatenate(([0], np.cumsum(steps))).astype(np.int64)
    scans = [
        Scan(int(stamp), scan.ranges_m[::-1].copy(), beams)
        for stamp, scan in zip(stamps, drive.scans[::-1], strict=True)
    ]
    return replace(
        drive,
        scans=scans,
        pairs=len(scans) - 1 - drive.pairs,
        a_t_b=drive.a_t_b * flip,
        base_t_laser=drive.base_t_laser * flip,
    )


def _near(drive: Drive) -> Drive:
    beams = replace(drive.scans[0].beams, range_max_m=NEAR_M)
    scans = []
    for scan in drive.scans:
        ranges_m = scan.ranges_m.copy()
        ranges_m[ranges_m > NEAR_M] = np.inf
        scans.append(Scan(scan.stamp_ns, ranges_m, beams))
    return replace(drive, scans=scans)


def _halved(drive: Drive) -> Drive:
    beams = drive.scans[0].beams
    half = replace(
        beams,
        count=(beams.count + 1) // 2,
        angle_increment_rad=2.0 * beams.angle_increment_rad,
        time_increment_s=2.0 * beams.time_increment_s,
    )
    return replace(drive, scans=[Scan(s.stamp_ns, s.ranges_m[::2].copy(), half) for s in drive.scans])


def _picked(drive: Drive, kept: np.ndarray) -> Drive:
    """Leave out all scans but some (K,), and the relations of those that are gone."""
    number = np.full(len(drive.scans), -1)
    number[kept] = np.arange(len(kept))
    pairs = number[drive.pairs]
    whole = (pairs >= 0).all(axis=1)
    scans = [drive.scans[index] for index in kept]
    return replace(drive, scans=scans, pairs=pairs[whole], a_t_b=drive.a_t_b[whole])


def _patchy(drive: Drive) -> Drive:
    rng = np.random.default_rng(8)
    scans = []
    for scan in drive.scans:
        ranges_m = scan.ranges_m.copy()
        ranges_m[rng.random(len(ranges_m)) < DARK_SHARE] = np.nan
        scans.append(Scan(scan.stamp_ns, ranges_m, scan.beams))
    return replace(drive, scans=scans)


def _thinned(drive: Drive) -> Drive:
    picked = _picked(drive, np.arange(0, len(drive.scans), 2))
    beams = drive.scans[0].beams
    slow = replace(beams, period_s=2.0 * beams.period_s)
    return replace(picked, scans=[replace(scan, beams=slow) for scan in picked.scans])


def _holed(drive: Drive) -> Drive:
    there = np.ones(len(drive.scans), bool)
    for first in np.random.default_rng(7).integers(50, len(there) - 50, HOLES):
        there[first : first + HOLE] = False
    return _picked(drive, np.flatnonzero(there))


def _later(drive: Drive) -> Drive:
    return _picked(drive, np.arange(len(drive.scans) // 2, len(drive.scans)))


def _log(name: str, bound_m: float, *changes: Callable) -> Callable:
    def make(_: int) -> Drive | None:
        course = logged(name)
        if course is None:
            return None
        drive = _with_relations(course, bound_m)
        for change in changes:
            drive = change(drive)
        return drive

    return make


_CORNERS = [(1.0, 1.0), (26.0, 1.0), (26.0, 26.0), (1.0, 26.0)]
_FROM_A_CORNER = np.array((*_CORNERS, *_CORNERS, (1.0, 1.0), (10.0, 1.0)))
"""Twice around the plain loop; its own route starts in mid side, where nothing is ever in sight."""

COURSES: dict[str, Callable[[int], Drive | None]] = {
    "intel": _log("intel", 0.035),
    "fr079": _log("fr079", 0.06),
    "intel backwards": _log("intel", 0.035, _backwards),
    "fr079 backwards": _log("fr079", 0.06, _backwards),
    "intel near": _log("intel", 0.035, _near),
    "fr079 near": _log("fr079", 0.06, _near),
    "fr079 halved": _log("fr079", 0.06, _halved),
    "intel halved": _log("intel", 0.035, _halved),
    "intel patchy": _log("intel", 0.035, _patchy),
    "fr079 patchy": _log("fr079", 0.06, _patchy),
    "intel thinned": _log("intel", 0.035, _thinned),
    "fr079 thinned": _log("fr079", 0.06, _thinned),
    "fr079 holed": _log("fr079", 0.06, _holed),
    "intel holed": _log("intel", 0.035, _holed),
    "intel later": _log("intel", 0.035, _later),
    "fr079 later": _log("fr079", 0.06, _later),
    "demo": _simulated(world.demo_building, 0.1),
    "demo fast": _simulated(world.demo_building, 0.1, speed_mps=0.6),
    "doors 20": _simulated(lambda: world.square_of_corridors(20.0), 0.1),
    "doors 20 twice": _simulated(lambda: world.square_of_corridors(20.0), 0.1, laps=2),
    "loop 100 from a corner": _simulated(world.loop_corridor, 0.1, route=_FROM_A_CORNER),
    "loop 100 twice": _simulated(world.loop_corridor, 0.1, laps=2),
    "square 100": _simulated(
        lambda: world.square_of_corridors(100.0), 0.1, world.Sick, speed_mps=0.8, laps=2
    ),
    "loop 100 SICK": _simulated(world.loop_corridor, 0.1, world.Sick, speed_mps=0.6),
    "square 40": _simulated(world.square_of_corridors, 0.1, world.Sick, speed_mps=0.6, laps=2),
    "square 40 1 m/s": _simulated(world.square_of_corridors, 0.1, world.Sick, speed_mps=1.0, laps=2),
    "floor SICK": _floor(world.Sick, 0, 0.1, speed_mps=0.6, turn_rate_radps=1.2),
    "floor SICK, people": _floor(world.Sick, 6, 0.1, speed_mps=0.6, turn_rate_radps=1.2),
    "floor URG": _floor(world.Urg04lx, 0, 0.2, speed_mps=0.4),
    "floor URG, people": _floor(world.Urg04lx, 6, 0.2, speed_mps=0.4),
    "floor spinning, dim": _floor(_dim, 0, 0.1, speed_mps=0.6, turn_rate_radps=1.5),
    "floor spinning": _floor(world.Spinning, 0, 0.1, speed_mps=0.6, turn_rate_radps=1.5),
    "floor URG, unsteady": _floor(world.Urg04lx, 0, 0.2, speed_mps=0.4, unsteady=UNSTEADY),
    "campus SICK": _campus(),
    "campus SICK, unsteady": _campus(UNSTEADY),
    "pillars": _simulated(lambda: world.pillar_hall(20.0, 12.0), 0.1),
}


def _changed(settings: list[str]) -> SlamConfig:
    config = SlamConfig()
    for setting in settings:
        name, _, value = setting.partition("=")
        part = "mapping" if hasattr(config.mapping, name) else "odometry"
        old = getattr(config, part)
        kind = type(getattr(old, name))
        new = kind(float(value)) if kind is not bool else value == "true"
        config = replace(config, **{part: replace(old, **{name: new})})
    return config


def measure(name: str, seed: int, settings: list[str]) -> dict | None:
    """Map a course once; return the figures of its trajectory, None where its log is not there."""
    drive = COURSES[name](seed)
    if drive is None:
        return None
    slam, states = Slam(_changed(settings), seed), {}
    odometry = []
    began = time.process_time()
    for scan, missed in by_stamps(drive.scans):
        step = slam.step(scan, missed)
        odometry.append(step.match.motion.odom_t_laser)
        states[step.match.state.value] = states.get(step.match.state.value, 0) + 1
    slam.finish()
    took_s = time.process_time() - began
    _, path = slam.trajectory()
    errors, alone = (_errors(drive, np.asarray(poses)) for poses in (path, odometry))
    mean = errors.translation_m.mean() if drive.truth is None else np.sqrt((errors.translation_m**2).mean())
    largest = errors.translation_m.max()
    return {
        "course": name,
        "seed": seed,
        "error_m": float(mean),
        "max_m": float(largest),
        "deg": float(errors.rotation_deg.mean()),
        "odometry_m": float(alone.translation_m.mean()),
        "good": bool(mean <= drive.bound_m and largest <= max(LARGEST_SHARE * drive.bound_m, LARGEST_M)),
        "lost": states.get("lost", 0),
        "degenerate": states.get("degenerate", 0),
        "cpu_s": round(took_s, 1),
    }


def _errors(drive: Drive, poses: Pose):
    if drive.truth is not None:
        return absolute_errors(drive.truth, poses)
    base = compose(poses, invert(np.tile(drive.base_t_laser, (len(poses), 1))))
    return relation_errors(base[drive.pairs[:, 0]], base[drive.pairs[:, 1]], drive.a_t_b)


def _jobs(names: list[str], seeds: range) -> Iterator[tuple[str, int]]:
    for name in names:
        for seed in seeds:
            yield name, seed


def main() -> None:
    """Print a line a run, and a table at the end."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("courses", nargs="*", help=f"default all: {', '.join(COURSES)}")
    parser.add_argument("--seeds", type=int, default=10)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--set", action="append", default=[], metavar="NAME=VALUE", help="of either part")
    args = parser.parse_args()
    names = args.courses or list(COURSES)
    jobs = list(_jobs(names, range(args.first, args.first + args.seeds)))
    rows: dict[str, list[dict]] = {}
    with ProcessPoolExecutor(args.workers) as pool:
        for row in pool.map(measure, *zip(*jobs, strict=True), [args.set] * len(jobs)):
            if row is not None:
                rows.setdefault(row["course"], []).append(row)
                print(json.dumps(row), flush=True)
    print("| course | good | error, m: mean, worst seed | largest, m | deg | odometry, m | CPU s |")
    print("|---|---|---|---|---|---|---|")
    for name, found in rows.items():
        mean = {key: np.array([row[key] for row in found]) for key in found[0] if key not in ("course",)}
        print(
            f"| {name} | {mean['good'].sum()} of {len(found)} | {mean['error_m'].mean():.4f}, "
            f"{mean['error_m'].max():.4f} | {mean['max_m'].max():.2f} | {mean['deg'].mean():.2f} | "
            f"{mean['odometry_m'].mean():.3f} | {np.median(mean['cpu_s']):.0f} |"
        )


if __name__ == "__main__":
    main()
