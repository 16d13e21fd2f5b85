"""Our matcher beside what people install instead, on the same pairs of scans: time, error, basin, memory.

    pip install '.[bench]'; python tests/bench/match_peers.py [--pairs N] [--only WORDS]

A match is one scan against one other, 0.3 s before it, reference built included. Simulated pairs are of a
URG-04LX that stands (room, hall, demo); pairs of exp1 are raw, and the odometry's own path is their truth,
which favours us there. Near: the start is off by up to 0.1 m and 5 degrees. Found: within 0.1 m and 3
degrees, from starts off by up to 0.1 m and 5 degrees, 0.3 m and 20 degrees, 0.5 m and 45 degrees.
Each row runs in a process of its own on one core; memory is the most that it held at once, over what it held
with Python, NumPy and our package loaded and no matcher made.
"""

import argparse
import json
import os
import pickle
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from odometry_courses import beams_of_laser, logged, simulated

from drivers import world
from processing.evolution import TABLE_1, EvolutionConfig
from processing.matching import Matcher, MatchingConfig
from processing.ndt import Ndt, NdtConfig
from processing.odometry import LaserOdometry, OdometryConfig
from processing.prediction import Prior
from processing.saliency import Resampler, ResamplingConfig
from processing.scan import Scan, end_points
from processing.se2 import between, compose

APART = 3
"""Scans from the reference to the matched one."""
LEVELS = ((0.1, 5.0), (0.3, 20.0), (0.5, 45.0))
STARTS = (1, 1, 2)
STRAIGHT_RADPS = 0.15
"""Pairs of exp1 turn no faster: a sweep that is bent by turning has no true place for anyone."""
LAYERS_M = (-0.05, 0.0, 0.05)
"""Heights at which small_gicp gets each point: a flat sheet of points has no walls, and no normals."""
FOUND_M, FOUND_DEG = 0.1, 3.0
WIDE = np.array((0.6, 0.6, 0.9))
"""Half sides of a window in which the farthest start finds the truth."""
WEAK = np.diag((1 / 0.3**2, 1 / 0.3**2, 1 / 0.4**2))
"""What a start claims of itself."""


def pairs(count):
    """(course, reference scan, scan, reference_t_scan) of `count` pairs of each of four courses."""
    laser, out = world.Urg04lx(), []
    beams, buildings = beams_of_laser(laser), (world.room, world.pillar_hall, world.demo_building)
    for seed, (name, building) in enumerate(zip(("room", "hall", "demo"), buildings, strict=True)):
        course, rng = simulated(name, seed), np.random.default_rng(seed)
        at = building()
        for k in np.linspace(20, len(course.scans) - 20, count).astype(int):
            poses = course.truth[k], course.truth[k + APART]
            seen = [laser.measure(at, np.tile(pose, (laser.beams, 1)), rng) for pose in poses]
            scans = [Scan(0, ranges_m, beams) for ranges_m in seen]
            out.append(("simulated", *scans, between(*poses)))
    if (course := logged("exp1")) is not None:
        odometry = LaserOdometry(OdometryConfig(), 0)
        motions = [odometry.step(scan).motion for scan in course.scans]
        way = [motion.odom_t_laser for motion in motions]
        turning = np.abs([motion.twist[2] for motion in motions])
        straight = [k for k in range(20, len(way) - 20) if turning[k : k + APART + 1].max() < STRAIGHT_RADPS]
        for k in np.array(straight)[np.linspace(0, len(straight) - 1, count).astype(int)]:
            out.append(("exp1", course.scans[k], course.scans[k + APART], between(way[k], way[k + APART])))
    return out


def raised(scan, heights_m=(0.0,)):
    """End points (M, 3) of a scan at each height."""
    points, _ = end_points(scan, np.zeros(3))
    return np.concatenate([np.column_stack((points, np.full(len(points), z))) for z in heights_m])


def matrix(pose):
    """Homogeneous 4 x 4 of a pose in the plane."""
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return np.array(((c, -s, 0, pose[0]), (s, c, 0, pose[1]), (0, 0, 1, 0), (0, 0, 0, 1)), np.float64)


def pose_of(transform):
    """The pose in the plane of a homogeneous 4 x 4."""
    return np.array((transform[0, 3], transform[1, 3], np.arctan2(transform[1, 0], transform[0, 0])))


def ours(config, window=None, resampling=None, search=None):
    """Resample both scans, build the transform of the one, match the other."""
    matcher, ndt, resampler = Matcher(config, 1), Ndt(NdtConfig()), None

    def means(scan):
        nonlocal resampler
        resampler = resampler or Resampler(resampling or ResamplingConfig(), scan.beams)
        resampler.points(scan, np.zeros(3))
        return resampler.means()

    def match(reference, scan, start):
        ndt.build(means(reference))
        points = means(scan)
        if search is not None:
            start = search(ndt, points, start)
        return matcher.match(points, ndt, Prior(start, WEAK), window).pose

    return match


def scipys():
    """SciPy's differential evolution on our sampled score, our numbers, then our polish."""
    from scipy.optimize import differential_evolution

    c = EvolutionConfig()

    def search(ndt, points, start):
        bounds = np.column_stack((start - WIDE, start + WIDE))
        rng = np.random.default_rng(0)
        initial = bounds[:, 0] + rng.random((c.population, 3)) * (bounds[:, 1] - bounds[:, 0])
        initial[0] = start

        def cost(pose):
            off = pose - start
            return 2.0 * np.log1p(off @ WEAK @ off / 4.0) - ndt.sampled_score(points, pose)

        found = differential_evolution(
            cost,
            bounds,
            strategy="rand1bin",
            maxiter=c.generations,
            mutation=c.factor,
            recombination=c.crossover,
            init=initial,
            polish=False,
            updating="deferred",
            rng=0,
        )
        return found.x

    return ours(MatchingConfig(search=EvolutionConfig(generations=0)), search=search)


def karto(wide):
    """Karto's correlative matcher as it comes, or with a window that reaches the farthest start."""
    import karto_scanmatcher as k

    config = k.ScanMatcherConfig()
    if wide:
        config.search_size = 2.0 * WIDE[0]
        config.coarse_search_angle_offset = WIDE[2]
    matcher = k.Wrapper(config)

    def localized(scan, pose, number):
        b = scan.beams
        last = b.angle_min_rad + b.angle_increment_rad * (b.count - 1)
        laser = k.LaserScanConfig(
            b.angle_min_rad, last, b.angle_increment_rad, b.range_min_m, b.range_max_m, b.range_max_m, "laser"
        )
        ranges = np.where(np.isfinite(scan.ranges_m), scan.ranges_m, 99.0).astype(float).tolist()
        pose = k.Pose2(*(float(v) for v in pose))
        return k.LocalizedRangeScan(laser, ranges, pose, pose, number, 0.1 * number)

    def match(reference, scan, start):
        found = matcher.match_scan(
            localized(scan, start, 1), [localized(reference, np.zeros(3), 0)], True, True
        )
        return np.array((found.best_pose.x, found.best_pose.y, found.best_pose.yaw))

    return match


def gicp(kind):
    """small_gicp, one thread, points thinned to 5 cm."""
    import small_gicp

    def match(reference, scan, start):
        found = small_gicp.align(
            raised(reference, LAYERS_M),
            raised(scan, LAYERS_M),
            matrix(start),
            registration_type=kind,
            downsampling_resolution=0.05,
            max_correspondence_distance=1.0,
            num_threads=1,
            max_iterations=50,
        )
        return pose_of(found.T_target_source)

    return match


def kiss():
    """KISS-ICP's registration against a voxel map of the one scan, its defaults, one thread."""
    from kiss_icp.mapping import VoxelHashMap
    from kiss_icp.registration import Registration

    registration = Registration(500, 1e-4, 1)

    def match(reference, scan, start):
        voxels = VoxelHashMap(voxel_size=0.1, max_distance=100.0, max_points_per_voxel=20)
        voxels.update(raised(reference), np.eye(4))
        return pose_of(registration.align_points_to_map(raised(scan), voxels, matrix(start), 1.0, 0.33))

    return match


def rows():
    """Name -> maker of a function (reference, scan, start) -> pose."""
    everything = ResamplingConfig(points=0)
    return {
        "ours, as it comes": lambda: ours(MatchingConfig()),
        "ours, window 0.6 m, 52 deg": lambda: ours(MatchingConfig(), WIDE),
        "ours, the same, Table 1": lambda: ours(MatchingConfig(search=TABLE_1), WIDE),
        "ours, the same, all points": lambda: ours(MatchingConfig(), WIDE, everything),
        "ours, polish alone": lambda: ours(MatchingConfig(search=EvolutionConfig(generations=0))),
        "SciPy's DE on our score, our polish": scipys,
        "karto-scanmatcher": lambda: karto(wide=False),
        "karto-scanmatcher, window 0.6 m, 52 deg": lambda: karto(wide=True),
        "small_gicp, GICP": lambda: gicp("GICP"),
        "small_gicp, point to plane": lambda: gicp("PLANE_ICP"),
        "KISS-ICP": kiss,
    }


def memory_kb(what):
    """Resident memory of this process now (VmRSS), or the most ever (VmHWM)."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if line.startswith(what)).split()[1])


def measure(name, path):
    """Run one row; print its figures as one line of JSON."""
    with path.open("rb") as file:
        all_pairs = pickle.load(file)
    before_kb = memory_kb("VmRSS")
    match = rows()[name]()
    rng = np.random.default_rng(5)
    errors = {(kind, level): [] for kind in ("simulated", "exp1") for level in range(len(LEVELS))}
    took_ms = []
    for number, (kind, reference, scan, truth) in enumerate(all_pairs):
        for level, ((off_m, off_deg), starts) in enumerate(zip(LEVELS, STARTS, strict=True)):
            for _ in range(starts):
                angle, size = rng.uniform(-np.pi, np.pi), off_m * np.sqrt(rng.random())
                turn = np.radians(off_deg) * rng.uniform(-1.0, 1.0)
                start = compose(truth, np.array((size * np.cos(angle), size * np.sin(angle), turn)))
                began = time.process_time()
                found = match(reference, scan, start)
                took = 1e3 * (time.process_time() - began)
                off = between(truth, found)
                errors[kind, level].append((np.hypot(off[0], off[1]), abs(np.degrees(off[2]))))
                if number > 2:
                    took_ms.append(took)
    figures = {"p50": np.percentile(took_ms, 50), "p99": np.percentile(took_ms, 99)}
    for (kind, level), values in errors.items():
        off = np.array(values).reshape(-1, 2)
        if len(off) and level == 0:
            figures[f"{kind} error"] = [1e3 * np.median(off[:, 0]), np.median(off[:, 1])]
        if len(off):
            good = (off[:, 0] < FOUND_M) & (off[:, 1] < FOUND_DEG)
            figures[f"{kind} found {level}"] = 100.0 * good.mean()
    figures["MB"] = (memory_kb("VmHWM") - before_kb) / 1024
    print(json.dumps(figures))


def main() -> None:
    """Make the pairs, run every row in its own process, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=20, help="of each of the four courses")
    parser.add_argument("--only", default="", help="rows whose names contain this")
    parser.add_argument("--row", help=argparse.SUPPRESS)
    parser.add_argument("--file", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.row:
        measure(args.row, args.file)
        return
    one_core = os.environ | dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
    print("| matcher | CPU ms p50 / p99 | error near, simulated | found, simulated | error near, exp1 | "
          "found, exp1 | MB |\n|---|---|---|---|---|---|---|")  # fmt: skip
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "pairs"
        file.write_bytes(pickle.dumps(pairs(args.pairs)))
        for name in rows():
            if args.only not in name:
                continue
            command = [sys.executable, __file__, "--row", name, "--file", str(file)]
            done = subprocess.run(command, env=one_core, capture_output=True, text=True, check=False)
            if done.returncode:
                print(f"| {name} | {done.stderr.strip().splitlines()[-1]} | | | | | |", flush=True)
                continue
            f = json.loads(done.stdout)
            cells = [name, f"{f['p50']:.1f} / {f['p99']:.1f}"]
            for kind in ("simulated", "exp1"):
                error = f.get(f"{kind} error")
                cells.append(f"{error[0]:.1f} mm, {error[1]:.2f} deg" if error else "-")
                found = (f.get(f"{kind} found {level}", np.nan) for level in range(len(LEVELS)))
                cells.append(" / ".join(f"{share:.0f}" for share in found) + " %")
            print(f"| {' | '.join(cells)} | {f['MB']:.0f} |", flush=True)


if __name__ == "__main__":
    main()
