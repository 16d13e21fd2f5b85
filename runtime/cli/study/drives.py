"""Seven buildings like those of the paper, a drive through each, and how well it was followed."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers import world
from drivers.world.drive import simulate_scans
from drivers.world.laser import bearings
from processing.evaluation import absolute_errors, relative_errors, summarise
from processing.occupancy import OccupancyGrid
from processing.odometry import LaserOdometry, OdometryConfig
from processing.scan import Beams, Scan
from processing.se2 import Pose, between, compose, transform
from processing.slam import Slam, SlamConfig

BUILDINGS: dict[str, Callable[[], world.Building]] = {
    "corridor": world.corridor,
    "hallway": world.hallway_with_doors,
    "room": world.room,
    "pillar hall": world.pillar_hall,
    "loop": lambda: world.loop_corridor(60.0),
    "square": lambda: world.square_of_corridors(20.0),
    "floor": world.demo_building,
}
STRETCH_M = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What a simulated URG-04LX saw on a drive, and where it was."""

    name: str
    scans: list[Scan]
    truth: Pose
    """(N, 3) of the laser at the first ray of each scan, seen from the first."""


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


def follow(drive: Drive, config: OdometryConfig, seed: int) -> Followed:
    """Follow the laser with the scan matcher alone."""
    odometry = LaserOdometry(config, seed)
    poses, hits, states = [], [], []
    began = time.process_time()
    for scan in drive.scans:
        match = odometry.step(scan)
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
    for scan in drive.scans:
        step = slam.step(scan)
        points.append(step.match.points_laser)
        states.append(step.match.state.name)
    took_s = time.process_time() - began
    _, poses = slam.trajectory()
    hits = [transform(pose, seen) for pose, seen in zip(poses, points, strict=True)]
    return _followed(list(poses), hits, states, took_s, slam.occupancy())


def _followed(
    poses: list[Pose],
    hits: list[NDArray[np.float64]],
    states: list[str],
    took_s: float,
    grid: OccupancyGrid | None = None,
) -> Followed:
    return Followed(
        np.array(poses),
        np.concatenate(hits),
        states.count("LOST"),
        states.count("DEGENERATE"),
        1e3 * took_s / len(states),
        grid,
    )


def errors(drive: Drive, followed: Followed) -> dict[str, float]:
    """Return how far the estimate is from the truth, by name and unit."""
    estimate = compose(np.zeros(3), followed.map_t_laser)
    ate = summarise(absolute_errors(drive.truth, estimate).translation_m)
    steps = between(drive.truth[:-1], drive.truth[1:])
    matched = between(estimate[:-1], estimate[1:])
    off = between(steps, matched)
    rpe = relative_errors(drive.truth, estimate, STRETCH_M)
    stretch_mm = 1e3 * summarise(rpe.translation_m).rmse if len(rpe) else float("nan")
    return {
        "match_mm": 1e3 * float(np.sqrt(np.mean(off[:, 0] ** 2 + off[:, 1] ** 2))),
        "match_deg": float(np.degrees(np.sqrt(np.mean(off[:, 2] ** 2)))),
        "stretch_mm": stretch_mm,
        "ate_m": ate.rmse,
        "max_m": ate.max,
        "lost": followed.lost,
        "degenerate": followed.degenerate,
        "ms": followed.ms_per_scan,
    }


def all_drives(scans_max: int, seed: int) -> Iterator[Drive]:
    """Yield a drive through each building."""
    for name in BUILDINGS:
        yield drive(name, scans_max, seed)
