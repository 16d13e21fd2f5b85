"""What each stage of the laser odometry earns: one table, a row for each thing left out or changed.

    python tests/bench/odometry_ablation.py [--whole] [--only WORDS] [--scans N]

Without --whole the first 2000 scans of the Intel and 1500 of the FR079 log are taken. Relations: mean of the
translational error in m / of the rotational in degrees. Simulated courses: largest error of position in % of
the way / in m, seen from the start; room, both corridors, hall and demo by a URG-04LX, the square of
corridors and the office floor by a SICK. exp1, exp2: rms / greatest difference of the distance moved in 1 s
from that by the wheels, m (about 0.05 is the wheels' own). Lost: scans on all courses together. CPU: ms a
scan of the one thread, median / 99th percentile, on exp1, warm.
"""

import argparse
import time
from dataclasses import replace

import numpy as np
from odometry_courses import logged, over_scans, simulated

from processing.evaluation import nearest_stamps, relation_errors
from processing.evolution import TABLE_1
from processing.odometry import LaserOdometry, OdometryConfig
from processing.se2 import between, compose, invert
from runtime.nodes.log_scans import by_stamps

PLACES = (
    "room",
    "corridor with doors",
    "people in a corridor",
    "hall",
    "demo",
    "square of corridors",
    "office floor",
)
FIRST = {"intel": 2000, "fr079": 1500}
WARM_UP = 20


def variants() -> dict[str, OdometryConfig]:
    """Name of a row -> configuration."""
    base = OdometryConfig()
    m, r, n, p = base.matching, base.resampling, base.ndt, base.prediction
    table_1 = replace(m, search=TABLE_1)
    none = replace(m.search, generations=0)
    # A velocity that may be anything: the scan alone decides where it lies.
    free = replace(p, acceleration=50.0, turning=50.0)
    paper = replace(
        base,
        reference="previous_scan",
        reference_points="resampled",
        fill_m=0.0,
        matching=replace(table_1, polish=False),
        ndt=replace(n, cell_m=0.5, fine_cell_m=0.0, flat_stretch=1.0),
    )
    return {
        "default": base,
        "no resampling": replace(base, resampling=replace(r, points=0)),
        "reference of resampled points": replace(base, reference_points="resampled"),
        "reference: key scan": replace(base, reference="key_scan"),
        "reference: previous scan": replace(base, reference="previous_scan"),
        "cells 0.25 m": replace(base, ndt=replace(n, cell_m=0.25, fine_cell_m=0.0)),
        "cells 0.5 m": replace(base, ndt=replace(n, cell_m=0.5, fine_cell_m=0.0)),
        "cells 1 m": replace(base, ndt=replace(n, cell_m=1.0, fine_cell_m=0.0)),
        "cells 1 + 0.5 m": replace(base, ndt=replace(n, cell_m=1.0, fine_cell_m=0.5)),
        "cells 0.5 + 0.125 m": replace(base, ndt=replace(n, cell_m=0.5, fine_cell_m=0.125)),
        "walls not filled in": replace(base, fill_m=0.0),
        "walls without sides": replace(base, walls_have_sides=False),
        "walls tell along, too": replace(base, walls_tell_across=False),
        "walkers trusted": replace(base, walkers_left_out=False),
        "flat cells not stretched": replace(base, ndt=replace(n, flat_stretch=1.0)),
        "DE alone": replace(base, matching=replace(m, polish=False)),
        "DE of Table 1 + polish": replace(base, matching=table_1),
        "DE of Table 1 alone": replace(base, matching=replace(table_1, polish=False)),
        "polish alone": replace(base, matching=replace(m, search=none)),
        "no coarse stage of the polish": replace(base, matching=replace(m, coarse_deviation_m=0.0)),
        "no prediction": replace(base, prediction=free),
        "a point weighs 1": replace(base, matching=replace(m, score_weight=1.0)),
        "local map of 20 key scans": replace(base, key_scans=20),
        "normal prior in the search": replace(base, matching=replace(m, freedom=1e6)),
        "no de-skew": replace(base, deskew=False),
        "the paper's chain": paper,
        "the paper's chain, bare": replace(paper, prediction=free, deskew=False),
    }


def follow(course, config):
    """Poses (N, 3), how many scans were lost, and CPU time of each (ms)."""
    odometry = LaserOdometry(config, 1)
    poses, lost, took_ms = [], 0, []
    for scan, missed in by_stamps(course.scans):
        began = time.thread_time()
        match = odometry.step(scan, missed)
        took_ms.append(1e3 * (time.thread_time() - began))
        poses.append(match.motion.odom_t_laser)
        lost += match.state.value == "lost"
    return np.array(poses), lost, np.array(took_ms[WARM_UP:])


def against_truth(course, poses) -> str:
    """Largest error of position in % of the way, and in m."""
    truth = course.truth[: len(poses)]
    off = between(between(truth[0], truth), between(poses[0], poses))
    worst = float(np.hypot(off[:, 0], off[:, 1]).max())
    way_m = float(np.hypot(*np.diff(truth[:, :2], axis=0).T).sum())
    return f"{100 * worst / way_m:.2f} / {worst:.2f}"


def against_relations(course, poses) -> str:
    """Mean errors of the relations whose scans were followed, m and degrees."""
    stamps, r = np.array([scan.stamp_ns for scan in course.scans]), course.relations
    a, b = (nearest_stamps(stamps, s, 1000) for s in (r.stamps_a_ns, r.stamps_b_ns))
    kept = (a >= 0) & (b >= 0)
    base = compose(poses, invert(np.tile(course.base_t_laser, (len(poses), 1))))
    if not kept.any():
        return "-"
    errors = relation_errors(base[a[kept]], base[b[kept]], r.a_t_b[kept])
    return f"{errors.translation_m.mean():.3f} / {errors.rotation_deg.mean():.2f}"


def against_wheels(course, poses) -> str:
    """Rms and greatest difference of the distance moved in a second, m."""
    second = round(1.0 / course.scans[0].beams.period_s)
    moved, wheeled = (np.hypot(*over_scans(way, second)[:, :2].T) for way in (poses, course.wheels))
    off = np.abs(moved - wheeled)
    return f"{np.sqrt(np.mean(off**2)):.3f} / {off.max():.2f}"


def main() -> None:
    """Print the table, a row as soon as it is measured."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--whole", action="store_true", help="all of Intel and FR079")
    parser.add_argument("--only", default="", help="rows whose names contain this")
    parser.add_argument("--scans", type=int, help="stop every course after so many")
    args = parser.parse_args()
    courses = [simulated(place) for place in PLACES]
    names = ("intel", "fr079", "exp1", "exp2")
    logs = [logged(name, args.scans or (None if args.whole else FIRST.get(name))) for name in names]
    for course in courses:
        del course.scans[args.scans or len(course.scans) :]
    courses = [log for log in logs if log is not None] + courses
    print(f"| | {' | '.join(course.name for course in courses)} | lost | CPU ms |")
    print("|---|" + "---|" * (len(courses) + 2))
    for name, config in variants().items():
        if args.only not in name:
            continue
        cells_, lost, cpu = [], 0, "-"
        for course in courses:
            poses, gone, took_ms = follow(course, config)
            lost += gone
            if course.relations is not None:
                cells_.append(against_relations(course, poses))
            elif course.wheels is not None:
                cells_.append(against_wheels(course, poses))
            else:
                cells_.append(against_truth(course, poses))
            if course.name == "exp1":
                cpu = f"{np.percentile(took_ms, 50):.1f} / {np.percentile(took_ms, 99):.1f}"
        print(f"| {name} | {' | '.join(cells_)} | {lost} | {cpu} |", flush=True)


if __name__ == "__main__":
    main()
