"""How well the velocity is known that goes on where the way is not seen.

    python tests/bench/blind_velocity.py [--seeds 2]

Stretches of two seconds and more in which one direction is not seen, in simulated corridors with a URG-04LX.
Error of the velocity along that direction against the mean true one of the stretch, rms, m/s: that of the
filter at the scan before, that of the last two seconds before, and the one that the odometry goes on with.
"""

import argparse

import numpy as np
from slam_seeds import COURSES

from processing.odometry import LaserOdometry, OdometryConfig
from processing.se2 import between

NAMES = ("doors 20 twice", "loop 100 from a corner")
LEAST_S = 2.0


def stretches(name: str, seed: int) -> list[tuple[float, float, float]]:
    """Return the three errors of each blind stretch of one drive."""
    drive = COURSES[name](seed)
    period_s = drive.scans[0].beams.period_s
    window = round(LEAST_S / period_s)
    odometry = LaserOdometry(OdometryConfig(), seed)
    matches = [odometry.step(scan) for scan in drive.scans]
    poses = np.array([match.motion.odom_t_laser for match in matches])
    true, found = (between(way[:-1], way[1:])[:, :2] / period_s for way in (drive.truth, poses))
    blind = np.array([match.blind_rad is not None for match in matches])
    errors = []
    for first in np.flatnonzero(blind[1:] & ~blind[:-1]) + 1:
        length = int(np.argmin(np.append(blind[first:], False)))
        if length < window or first < window:
            continue
        along = np.array((np.cos(matches[first].blind_rad), np.sin(matches[first].blind_rad)))
        truth = true[first : first + length].mean(axis=0)
        claims = (
            matches[first - 1].motion.twist[:2],
            found[first - 1 - window : first - 1].mean(axis=0),
            matches[first].motion.twist[:2],
        )
        errors.append(tuple(float(along @ (claim - truth)) for claim in claims))
    return errors


def main() -> None:
    """Print a line for each drive."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=2)
    args = parser.parse_args()
    print("| course | seed | stretches | the filter's own | last 2 s | what goes on |")
    print("|---|---|---|---|---|---|")
    for name in NAMES:
        for seed in range(args.seeds):
            errors = np.array(stretches(name, seed))
            rms = " | ".join(f"{value:.4f}" for value in np.sqrt((errors**2).mean(axis=0)))
            print(f"| {name} | {seed} | {len(errors)} | {rms} |", flush=True)


if __name__ == "__main__":
    main()
