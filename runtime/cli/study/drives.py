"""A drive through a building like the paper's, or out of a log, and how well it was followed."""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers import world
from drivers.world.drive import simulate_scans
from drivers.world.laser import bearings
from processing.evaluation import absolute_errors, relative_errors, summarise
from processing.occupancy import OccupancyGrid
from processing.odometry import LaserOdometry, OdometryConfig
from processing.scan import Beams, Scan, end_points
from processing.se2 import Pose, between, compose, transform
from processing.sharpness import sharpness
from processing.slam import Slam, SlamConfig
from runtime.formats.logs import open_log
from runtime.nodes.log_scans import by_stamps, iterate

BUILDINGS: dict[str, Callable[[], world.Building]] = {
    "corridor": world.corridor,
    "hallway": world.hallway_with_doors,
    "doorway": world.doorway,
    "pillar hall": world.pillar_hall,
    "loop": lambda: world.loop_corridor(32.0),
    "square": lambda: world.square_of_corridors(8.0),
    "floor": world.demo_building,
}
STRETCH_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What a simulated URG-04LX saw on a drive, and where it was."""

    name: str
    scans: list[Scan]
    truth: Pose | None
    """(N, 3) of the laser at the first ray of each scan, seen from the first; None where nobody knows."""


@dataclass(frozen=True, slots=True, eq=False)
class Followed:
    """What was made of a drive."""

    map_t_laser: Pose
    hits_map: NDArray[np.float64]
    """(M, 2) the points that the matches used."""
    lost: int
    degenerate: int
    ms_per_scan: float
    grid: OccupancyGrid | None = None
    lineages: tuple[Pose, ...] = ()
    """(K, 3) of each particle at the key scans, that of the best one first."""


def drive(name: str, scans_max: int, seed: int) -> Drive:
    """Simulate a drive through one of the buildings."""
    laser = world.Urg04lx()
    directions = bearings(laser)
    beams = Beams(
        count=laser.beams,
        angle_min_rad=float(directions[0]),
        angle_increment_rad=float(directions[1] - directions[0]),
        time_increment_s=laser.time_increment_s,
        period_s=laser.period_s,
        range_max_m=5.6,
    )
    scans, poses = [], []
    for stamp_ns, ranges_m, pose in simulate_scans(BUILDINGS[name](), max_scans=scans_max, seed=seed):
        scans.append(Scan(stamp_ns, ranges_m, beams))
        poses.append(pose)
    truth = np.array(poses)
    return Drive(name, scans, between(truth[0], truth))


def logged(path: Path, scans_max: int) -> Drive:
    """Read a drive from a log of any kind that `hallway map` takes."""
    scans = [scan for scan, _ in zip(iterate(open_log(path)), range(scans_max), strict=False)]
    return Drive(path.name.split(".")[0], scans, None)


def hurried(drive: Drive, times: int) -> Drive:
    """Return the drive as it looks when only every so many-th scan is seen: that much faster, as sharp."""
    beams = replace(drive.scans[0].beams, period_s=times * drive.scans[0].beams.period_s)
    scans = [Scan(scan.stamp_ns, scan.ranges_m, beams) for scan in drive.scans[::times]]
    return Drive(drive.name, scans, None if drive.truth is None else drive.truth[::times])


def follow(drive: Drive, config: OdometryConfig, seed: int) -> Followed:
    """Follow the laser with the scan matcher alone."""
    odometry = LaserOdometry(config, seed)
    poses, hits, states = [], [], []
    began = time.process_time()
    for scan, missed in by_stamps(drive.scans):
        match = odometry.step(scan, missed)
        poses.append(match.motion.odom_t_laser)
        hits.append(transform(match.motion.odom_t_laser, match.points_laser))
        states.append(match.state.name)
    took_s = time.process_time() - began
    return _followed(poses, hits, states, took_s)


def map_it(drive: Drive, config: SlamConfig, seed: int) -> Followed:
    """Follow the laser with the whole pipeline."""
    slam = Slam(config, seed)
    points, states = [], []
    began = time.process_time()
    for scan, missed in by_stamps(drive.scans):
        step = slam.step(scan, missed)
        points.append(step.match.points_laser)
        states.append(step.match.state.name)
    took_s = time.process_time() - began
    _, poses = slam.trajectory()
    hits = [transform(pose, seen) for pose, seen in zip(poses, points, strict=True)]
    people = slam.mapping.population
    order = [people.best, *(p for p in range(people.config.particles) if p != people.best)]
    lineages = tuple(people.ancestry.path(particle) for particle in order)
    return _followed(list(poses), hits, states, took_s, slam.occupancy(), lineages)


def _followed(
    poses: list[Pose],
    hits: list[NDArray[np.float64]],
    states: list[str],
    took_s: float,
    grid: OccupancyGrid | None = None,
    lineages: tuple[Pose, ...] = (),
) -> Followed:
    return Followed(
        np.array(poses),
        np.concatenate(hits),
        states.count("LOST"),
        states.count("DEGENERATE"),
        1e3 * took_s / len(states),
        grid,
        lineages,
    )


def errors(drive: Drive, followed: Followed) -> dict[str, float]:
    """Return how far the estimate is from the truth, by name and unit.

    Where nobody knows the truth: how crisp the map is that the scans make at the estimated poses.
    """
    said = {
        "lost": followed.lost,
        "degenerate": followed.degenerate,
        "ms": followed.ms_per_scan,
        "scans": len(drive.scans),
    }
    if drive.truth is None:
        crisp = sharpness(
            [
                transform(pose, end_points(scan, np.zeros(3))[0])
                for pose, scan in zip(followed.map_t_laser, drive.scans, strict=True)
            ],
            followed.map_t_laser[:, :2],
        )
        return said | {"entropy": crisp.mean_map_entropy, "conflict": crisp.ray_conflict}
    estimate = compose(np.zeros(3), followed.map_t_laser)
    ate = summarise(absolute_errors(drive.truth, estimate).translation_m)
    steps = between(drive.truth[:-1], drive.truth[1:])
    matched = between(estimate[:-1], estimate[1:])
    off = between(steps, matched)
    rpe = relative_errors(drive.truth, estimate, STRETCH_M)
    stretch_mm = 1e3 * summarise(rpe.translation_m).rmse if len(rpe) else float("nan")
    return {
        "match_mm": 1e3 * float(np.sqrt(np.mean(off[:, 0] ** 2 + off[:, 1] ** 2))),
        "ahead_mm": 1e3 * float(np.sqrt(np.mean(off[:, 0] ** 2))),
        "aside_mm": 1e3 * float(np.sqrt(np.mean(off[:, 1] ** 2))),
        "match_deg": float(np.degrees(np.sqrt(np.mean(off[:, 2] ** 2)))),
        "stretch_mm": stretch_mm,
        "ate_m": ate.rmse,
        "max_m": ate.max,
        **said,
    }
