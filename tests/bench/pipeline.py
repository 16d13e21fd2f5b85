"""CPU time a scan of each stage, speed against real time, and memory: one table a log.

    python tests/bench/pipeline.py ../shared/data/exp1.dat ../shared/data/intel.clf.bz2

Times are of the CPU of the one thread, so that a busy machine blurs them less; the first scans, which load
compiled code, are left out. `Table 1` is the matcher with the paper's values of differential evolution.
"""

import argparse
import resource
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from processing.evolution import TABLE_1
from processing.odometry import LaserOdometry, OdometryConfig
from processing.saliency import Resampler
from processing.slam import Slam, SlamConfig
from runtime.nodes.log_scans import scans_of

WARM_UP = 20


def main() -> None:
    """Measure the logs named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--scans", type=int, default=10**9, help="stop after so many")
    args = parser.parse_args()
    for log in args.logs:
        measure(log, args.scans)


def measure(log: Path, most: int) -> None:
    """Print the table of one log."""
    default, paper = OdometryConfig(), OdometryConfig()
    paper = replace(paper, matching=replace(paper.matching, search=TABLE_1))
    slam = Slam(SlamConfig(odometry=default), 1)
    table_1 = LaserOdometry(paper, 1)
    resampler: Resampler | None = None
    times_ms: dict[str, list[float]] = {
        "resample": [],
        "match, default": [],
        "match, Table 1": [],
        "map, key scans": [],
        "map, all scans": [],
    }
    counts = []
    beams, scans = scans_of(log)
    began = time.thread_time()
    beside = 0.0
    for number, scan in enumerate(scans):
        if number == most:
            break
        resampler = resampler or Resampler(default.resampling, beams)
        at = [time.thread_time()]
        resampler.points(scan, np.zeros(3))
        means = resampler.means()
        at.append(time.thread_time())
        table_1.step(scan)
        at.append(time.thread_time())
        match = slam.odometry.step(scan)
        at.append(time.thread_time())
        mapped = slam.mapping.step(scan, match.motion)
        at.append(time.thread_time())
        beside += at[2] - at[0]
        if number < WARM_UP:
            continue
        took_ms = 1e3 * np.diff(at)
        counts.append(len(means))
        times_ms["resample"].append(took_ms[0])
        times_ms["match, Table 1"].append(took_ms[1])
        times_ms["match, default"].append(took_ms[2])
        times_ms["map, all scans"].append(took_ms[3])
        if mapped.updated:
            times_ms["map, key scans"].append(took_ms[3])
    took_s = time.thread_time() - began - beside
    lasted_s = (number + 1) * beams.period_s
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"{log.name}: {beams.count} beams, {np.median(counts):.0f} points after resampling (median)")
    print(f"  {'ms of CPU a scan':<18}{'p50':>8}{'p99':>8}{'max':>8}")
    for name, values in times_ms.items():
        p50, p99, most_ms = np.percentile(values, (50, 99, 100))
        print(f"  {name:<18}{p50:>8.2f}{p99:>8.2f}{most_ms:>8.1f}")
    print(
        f"  matcher and mapper: {lasted_s / took_s:.0f} x real time on one core, peak {peak_mb:.0f} MB\n",
        flush=True,
    )


if __name__ == "__main__":
    main()
