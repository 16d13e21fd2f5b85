"""Whether the odometry's covariances are true: normalised errors against truth and against relations.

    python tests/bench/odometry_nees.py [--scans N] [--json]

NEES = e^T C^-1 e of three numbers: 2.37 is its median where C is true, 3 its mean, and 95 % lie under 7.81.
`match` is the motion from scan to scan under the covariance that comes with it; `1 s` the motion over ten
scans (SICK: five) under the sum of theirs, carried along. Along is ahead of the laser. `too wide` is the
stated standard deviation over the measured one, for each axis: 1 is true, 2 claims twice the error that is
made, 0.5 half of it. Between errors of neighbouring matches `echo` is the correlation: -0.5 where each pose
errs by itself against the map, 0 where errors add up like a random walk.
"""

import argparse
import json

import numpy as np
from odometry_courses import logged, over_scans, simulated

from processing.evaluation import nearest_stamps
from processing.motion import UNKNOWN_VARIANCE
from processing.odometry import LaserOdometry, OdometryConfig, Tracking
from processing.se2 import between, compose, invert

BOUND, MEDIAN = 7.815, 2.366
SETTLING = 5
"""Matches at the start that are left out: the robot rests and the filter learns its velocity."""
PLACES = ("room", "corridor with doors", "plain corridor", "hall", "stand-still", "square of corridors")
SEEDS = 3
RELATION_NOISE = {"intel": (0.015, 0.005), "fr079": (0.025, 0.010)}
"""Standard deviation of the relations themselves, m an axis and rad: what a fit to them leaves."""


def followed(course, config, seed=0):
    """Poses (N, 3), covariances (N, 3, 3) and states of a course."""
    odometry = LaserOdometry(config, seed)
    matches = [odometry.step(scan) for scan in course.scans]
    poses = np.array([match.motion.odom_t_laser for match in matches])
    covariances = np.array([match.motion.covariance for match in matches])
    return poses, covariances, np.array([match.state for match in matches])


def adjoints(poses):
    """Matrices (N, 3, 3) that carry small motions in each pose's frame to the common one."""
    x, y, yaw = poses.T
    c, s, o, i = np.cos(yaw), np.sin(yaw), np.zeros(len(poses)), np.ones(len(poses))
    return np.array(((c, -s, y), (s, c, -x), (o, o, i))).transpose(2, 0, 1)


def summed(poses, covariances, first, last):
    """Covariances (M, 3, 3) of the motions from pose `first` (M,) to `last`, in the frame of the last."""
    to_odom = adjoints(poses)
    running = np.cumsum(to_odom @ covariances @ to_odom.transpose(0, 2, 1), axis=0)
    back = adjoints(invert(poses[last]))
    return back @ (running[last] - running[first]) @ back.transpose(0, 2, 1)


def normalised(errors, covariances):
    """e^T C^-1 e of errors (M, 3)."""
    return np.einsum("ki,ki->k", errors, np.linalg.solve(covariances, errors[..., None])[..., 0])


def row(name, what, errors, covariances):
    """One line of the table."""
    nees = normalised(errors, covariances)
    stated = np.sqrt(np.mean(covariances[:, range(3), range(3)], axis=0))
    made = np.sqrt(np.mean(errors**2, axis=0))
    echo = [np.corrcoef(e[:-1], e[1:])[0, 1] for e in errors.T] if what == "match" else [np.nan] * 3
    return {
        "course": name,
        "what": what,
        "n": len(nees),
        "median": round(float(np.median(nees)), 3),
        "mean": round(float(nees.mean()), 3),
        "within": round(float(np.mean(nees < BOUND)), 4),
        "wide": [round(float(v), 2) for v in stated / made],
        "made": [*np.round(1e3 * made[:2], 2).tolist(), round(float(np.degrees(made[2])), 4)],
        "echo": [round(float(v), 2) for v in echo],
    }


def simulated_rows(config, places=PLACES, seeds=SEEDS, most=None):
    """Each place, all seeds together."""
    rows = []
    for place in places:
        kinds = {"match": ([], []), "1 s": ([], [])}
        for seed in range(seeds):
            course = simulated(place, seed)
            course.scans[:] = course.scans[:most]
            truth = course.truth[: len(course.scans)]
            poses, covariances, _ = followed(course, config, seed)
            second = round(1.0 / course.scans[0].beams.period_s)
            for what, steps in (("match", 1), ("1 s", second)):
                errors = between(over_scans(truth, steps), over_scans(poses, steps))
                first = np.arange(len(poses) - steps)
                kinds[what][0].append(errors[SETTLING:])
                kinds[what][1].append(summed(poses, covariances, first, first + steps)[SETTLING:])
        rows += [row(place, what, np.concatenate(e), np.concatenate(c)) for what, (e, c) in kinds.items()]
    return rows


def relation_rows(config, most=None):
    """Intel and FR079: pairs near in time and far."""
    rows = []
    for name, (noise_m, noise_rad) in RELATION_NOISE.items():
        course = logged(name, most)
        if course is None:
            continue
        poses, covariances, states = followed(course, config)
        lost = np.array([state is Tracking.LOST for state in states])
        covariances[covariances[:, 2, 2] >= UNKNOWN_VARIANCE] = np.diag((0.01, 0.01, 0.01))
        stamps = np.array([scan.stamp_ns for scan in course.scans])
        r = course.relations
        a, b = (nearest_stamps(stamps, s, 1000) for s in (r.stamps_a_ns, r.stamps_b_ns))
        back = a > b
        first, last = np.where(back, b, a), np.where(back, a, b)
        truth = np.where(back[:, None], invert(r.a_t_b), r.a_t_b)
        base = compose(poses, invert(np.tile(course.base_t_laser, (len(poses), 1))))
        apart = last - first
        for low, high, what in ((1, 50, "under 10 s"), (50, 500, "10-100 s"), (500, 10**6, "over 100 s")):
            kept = (first >= 0) & (last >= 0) & (apart >= low) & (apart < high)
            if kept.sum() < 30:
                continue
            i, j = first[kept], last[kept]
            errors = between(truth[kept], between(base[i], base[j]))
            stated = summed(base, covariances, i, j) + np.diag((noise_m, noise_m, noise_rad)) ** 2
            rows.append(row(f"{name} ({lost.sum()} lost)", what, errors, stated))
    return rows


def show(rows):
    """Print as a table of Markdown."""
    print("| course | | n | median | mean | within 95 % | too wide: along, across, yaw | "
          "error: mm, mm, deg | echo |")  # fmt: skip
    print("|---|---|---|---|---|---|---|---|---|")
    for r in rows:
        lists = (
            " / ".join("-" if np.isnan(v) else f"{v:g}" for v in r[key]) for key in ("wide", "made", "echo")
        )
        print(f"| {r['course']} | {r['what']} | {r['n']} | {r['median']} | {r['mean']} | "
              f"{100 * r['within']:.1f} % | {' | '.join(lists)} |", flush=True)  # fmt: skip


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scans", type=int, help="stop each course and log after so many")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = simulated_rows(OdometryConfig(), most=args.scans) + relation_rows(OdometryConfig(), args.scans)
    if args.json:
        print(json.dumps({"bench": "odometry_nees", "rows": rows}))
    else:
        show(rows)


if __name__ == "__main__":
    main()
