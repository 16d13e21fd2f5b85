"""What the mapper costs: time and memory against particles, beams, area, and time in the same building.

`python tests/bench/dpslam_scale.py [particles|beams|area|hour]`: CPU time of a key scan on one core, memory
of the maps, and what a filter with a whole map for each particle would take.
"""

import argparse
import json
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from drivers.world import Sick, Urg04lx, demo_building, pillar_hall, simulate_scans
from processing import se2
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.filter import DpSlam
from processing.dpslam.grid import TILE
from processing.motion import Motion
from processing.odometry import LaserOdometry, OdometryConfig
from processing.scan import Scan
from tests.lasers import beams_of_laser

NAIVE_CELL_BYTES = 8


def scans_of(building, laser, **drive):
    """Scans of a drive with the motions of the laser odometry."""
    odometry, beams = LaserOdometry(OdometryConfig(), 0), beams_of_laser(laser)
    for stamp_ns, ranges_m, _ in simulate_scans(building, laser=laser, **drive):
        scan = Scan(stamp_ns, ranges_m.copy(), beams)
        yield scan, odometry.step(scan).motion


def true_scans_of(building, laser, **drive):
    """Scans of a drive with nearly true motions: where the odometry is not what is measured."""
    beams, start, before = beams_of_laser(laser), None, None
    covariance = np.diag((0.01**2, 0.01**2, 0.003**2))
    for stamp_ns, ranges_m, pose in simulate_scans(building, laser=laser, **drive):
        start = pose if start is None else start
        twist = np.zeros(3) if before is None else se2.between(before, pose) / laser.period_s
        before = pose
        odom = se2.snap_yaw(se2.between(start, pose))
        yield Scan(stamp_ns, ranges_m.copy(), beams), Motion(stamp_ns, odom, covariance, twist)


def run(course, config, keys):
    """Feed until `keys` key scans are mapped; return the mapper and the CPU time of each (ms)."""
    slam, took_ms = DpSlam(config), []
    for scan, motion in course:
        began = time.thread_time()
        step = slam.step(scan, motion)
        if step.updated:
            took_ms.append(1e3 * (time.thread_time() - began))
            if len(took_ms) == keys:
                break
    return slam, np.array(took_ms[1:])


def row(name, slam, took_ms):
    """Print and return one line of a table."""
    store = slam.population.store
    occupied = (store.table >= 0).any(axis=0)
    rows, cols = np.nonzero(occupied)
    boxed = (np.ptp(rows) + 1) * (np.ptp(cols) + 1) * TILE * TILE
    naive = slam.config.particles * boxed * NAIVE_CELL_BYTES / 1e6
    values = {
        "ms_p50": round(float(np.percentile(took_ms, 50)), 1),
        "ms_p99": round(float(np.percentile(took_ms, 99)), 1),
        "MB": round(store.bytes_used / 1e6, 1),
        "naive_MB": round(naive, 1),
        "ratio": round(naive / (store.bytes_used / 1e6), 1),
        "nodes": slam.population.ancestry.node_count,
        "known_m2": round(float((~np.isnan(slam.occupancy().probability)).sum()) * 0.05**2),
    }
    print(f"{name:>12}  " + "  ".join(f"{key} {value}" for key, value in values.items()), flush=True)
    return {"name": name, **values}


def particles():
    """Against particles, 682 beams, in the rooms of the demo building."""
    course = list(scans_of(demo_building(), Urg04lx(), max_scans=700))
    table = []
    for count in (50, 100, 200, 500, 1000, 2000, 3000):
        slam, took_ms = run(course, DpSlamConfig(particles=count), 200 if count <= 500 else 70)
        table.append(row(count, slam, took_ms))
    return table


def beams():
    """Against beams, 50 particles: the same half circle, cut finer."""
    table = []
    for count in (90, 180, 360, 720, 1440):
        laser = replace(
            Sick(), beams=count, angle_increment_rad=np.pi / count, range_max_m=20.0, period_s=0.1
        )
        course = true_scans_of(demo_building(), laser, max_scans=700)
        table.append(row(count, *run(course, DpSlamConfig(), 150)))
    return table


def area():
    """Against the ground mapped, 50 particles: halls of pillars, 4 x 2.5 m to 100 x 100 m."""
    table = []
    for side, speed in ((3.2, 0.3), (10.0, 0.5), (32.0, 1.0), (100.0, 2.0)):
        every = max(1.1, side / 12)
        laser = replace(Sick(), range_max_m=30.0)
        course = true_scans_of(pillar_hall(side, side, every), laser, speed_mps=speed, max_scans=6000)
        table.append(row(f"{side * side:.0f} m2", *run(course, DpSlamConfig(), 10_000)))
    return table


def hour():
    """An hour in the demo building, lap after lap, a URG at 0.5 m/s: what grows with time?"""
    config = DpSlamConfig()
    slam, took_ms, table = DpSlam(config), [], []
    course = scans_of(demo_building(), Urg04lx(), speed_mps=0.5, laps=60, max_scans=36_000)
    for number, (scan, motion) in enumerate(course, 1):
        began = time.thread_time()
        if slam.step(scan, motion).updated:
            took_ms.append(1e3 * (time.thread_time() - began))
        if number % 6000 == 0:
            entry = row(f"{number // 600} min", slam, np.array(took_ms))
            entry["scans_MB"] = round(slam._scans.bytes_used / 1e6, 1)
            entry["loops_MB"] = round(sum(part.nbytes for part in slam.loops.state().values()) / 1e6, 1)
            entry["key_scans"] = slam.population.keys
            status = Path("/proc/self/statm").read_text().split()
            entry["resident_MB"] = round(int(status[1]) * 4096 / 1e6)
            print(f"{'':>12}  {dict(list(entry.items())[-4:])}", flush=True)
            table.append(entry)
            took_ms = []
    return table


if __name__ == "__main__":
    tables = {"particles": particles, "beams": beams, "area": area, "hour": hour}
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("tables", nargs="*", help=f"default all: {', '.join(tables)}")
    wanted = parser.parse_args().tables or list(tables)
    if unknown := [name for name in wanted if name not in tables]:
        parser.error(f"no table {unknown[0]!r}; there are {', '.join(tables)}")
    for name in wanted:
        print(f"-- {tables[name].__doc__}")
        print(json.dumps({"bench": f"dpslam_scale {name}", "rows": tables[name]()}))
