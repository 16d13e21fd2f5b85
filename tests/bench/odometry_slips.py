"""Where the odometry alone slips farther than it says, over simulated buildings: each seed is another one.

    python tests/bench/odometry_slips.py [COURSE ...] [--seeds 8] [--first 0] [--workers 2]

Courses are those of `slam_seeds.py` that have a true path. A stretch is twenty scans; it slips if its motion
is off by more than 0.1 m and by more than five times what the motions claim, taken together, one sigma.
"""

import argparse
import json
from concurrent.futures import ProcessPoolExecutor

import numpy as np
from slam_seeds import COURSES

from processing.evaluation import absolute_errors
from processing.odometry import LaserOdometry, OdometryConfig
from processing.se2 import between
from runtime.nodes.log_scans import by_stamps

DEFAULT = (
    "campus SICK",
    "campus SICK, unsteady",
    "floor SICK",
    "floor spinning",
    "floor spinning, dim",
    "floor URG",
    "floor URG, unsteady",
    "floor URG, people",
)
STRETCH, STEP = 20, 10
SLIP_M, SLIP_SIGMAS = 0.1, 5.0


def measure(name: str, seed: int) -> dict | None:
    """Drive a course once; return the figures of its odometry, None where there is no true path."""
    drive = COURSES[name](seed)
    if drive is None or drive.truth is None:
        return None
    odometry = LaserOdometry(OdometryConfig(), seed)
    matches = [odometry.step(scan, missed) for scan, missed in by_stamps(drive.scans)]
    poses = np.array([match.motion.odom_t_laser for match in matches])
    covariances = np.array([match.motion.covariance[:2, :2] for match in matches[1:]])
    off = (between(poses[:-1], poses[1:]) - between(drive.truth[:-1], drive.truth[1:]))[:, :2]
    slips = []
    for first in range(0, len(off) - STRETCH, STEP):
        part = slice(first, first + STRETCH)
        slip, covariance = off[part].sum(axis=0), covariances[part].sum(axis=0)
        slips.append((np.hypot(*slip), np.sqrt(slip @ np.linalg.solve(covariance, slip))))
    far_m, sigmas = np.array(slips).T
    errors_m = absolute_errors(drive.truth, poses).translation_m
    states = [match.state.value for match in matches]
    return {
        "course": name,
        "seed": seed,
        "way_m": round(float(np.hypot(*np.diff(drive.truth[:, :2], axis=0).T).sum())),
        "mean_m": round(float(errors_m.mean()), 3),
        "max_m": round(float(errors_m.max()), 2),
        "slips": int(((far_m > SLIP_M) & (sigmas > SLIP_SIGMAS)).sum()),
        "stretches": len(slips),
        "greatest_slip_m": round(float(far_m.max()), 2),
        "degenerate": round(states.count("degenerate") / len(states), 3),
        "lost": states.count("lost"),
    }


def main() -> None:
    """Print a line a drive, and a table at the end."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("courses", nargs="*", default=DEFAULT, help=f"default: {', '.join(DEFAULT)}")
    parser.add_argument("--seeds", type=int, default=8)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--workers", type=int, default=2)
    args = parser.parse_args()
    jobs = [(name, seed) for name in args.courses for seed in range(args.first, args.first + args.seeds)]
    rows: dict[str, list[dict]] = {}
    with ProcessPoolExecutor(args.workers) as pool:
        for row in pool.map(measure, *zip(*jobs, strict=True)):
            if row is not None:
                rows.setdefault(row["course"], []).append(row)
                print(json.dumps(row), flush=True)
    print(
        "| course | off, m: mean, worst drive | farthest, m | slips a thousand stretches | greatest, m | ",
        end="",
    )
    print("DEGENERATE | LOST scans |")
    print("|---|---|---|---|---|---|---|")
    for name, found in rows.items():
        column = {key: np.array([row[key] for row in found]) for key in found[0] if key != "course"}
        mean_m, max_m = column["mean_m"], column["max_m"].max()
        share = 1e3 * column["slips"].sum() / column["stretches"].sum()
        print(
            f"| {name} | {mean_m.mean():.3f}, {mean_m.max():.3f} | {max_m:.2f} | {share:.1f} | "
            f"{column['greatest_slip_m'].max():.2f} | {column['degenerate'].mean():.2f} | "
            f"{column['lost'].sum()} |"
        )


if __name__ == "__main__":
    main()
