"""CPU time a scan of each stage, speed against real time, and memory: one table a log.

    python tests/bench/pipeline.py ../shared/data/exp1.dat ../shared/data/intel.clf.bz2

Times are of the CPU of the one thread, so that a busy machine blurs them less; the first scans, which load
compiled code, are left out. Each stage goes through the log alone, as it has a process and a core of its own
on a robot. All go through it several times in turn, and a scan's time is the median of its times: the work is
the same to the last bit each time, and what differs is the machine. `Table 1` is the matcher with the paper's
values of differential evolution.
"""

import argparse
import resource
import sys
import time
from dataclasses import replace
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).parents[2]))

from processing.dpslam.config import DpSlamConfig
from processing.dpslam.filter import DpSlam
from processing.evolution import TABLE_1
from processing.motion import Motion
from processing.odometry import LaserOdometry, OdometryConfig
from processing.saliency import Resampler
from processing.scan import Beams, Scan
from runtime.nodes.log_scans import scans_of

Times = NDArray[np.float64]

WARM_UP = 20


def main() -> None:
    """Measure the logs named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--scans", type=int, default=10**9, help="stop after so many")
    parser.add_argument("--passes", type=int, default=3, help="times that each stage goes through the log")
    args = parser.parse_args()
    for log in args.logs:
        measure(log, args.scans, args.passes)


def measure(log: Path, most: int, passes: int) -> None:
    """Print the table of one log."""
    beams, scans = read(log, most)
    counts, times_of_passes = zip(*(go_through(beams, scans) for _ in range(passes)), strict=True)
    times_ms = {
        stage: np.median([times[stage] for times in times_of_passes], axis=0) for stage in times_of_passes[0]
    }
    print(f"{log.name}: {beams.count} beams, {np.median(counts[0]):.0f} points after resampling (median)")
    print(f"  {'ms of CPU a scan':<18}{'p50':>8}{'p99':>8}{'max':>8}")
    for name, values in times_ms.items():
        p50, p99, most_ms = np.percentile(values, (50, 99, 100))
        print(f"  {name:<18}{p50:>8.2f}{p99:>8.2f}{most_ms:>8.1f}")
    times_real = (
        1e3 * beams.period_s / (times_ms["match, default"].mean() + times_ms["map, all scans"].mean())
    )
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(
        f"  matcher and mapper: {times_real:.0f} x real time on one core, peak {peak_mb:.0f} MB\n", flush=True
    )


def go_through(beams: Beams, scans: list[Scan]) -> tuple[Times, dict[str, Times]]:
    """Return how many points of each scan are left, and the time that each stage took for each scan, ms."""
    default = OdometryConfig()
    table_1 = replace(default, matching=replace(default.matching, search=TABLE_1))
    resampling_ms, counts = resample(Resampler(default.resampling, beams), scans)
    matching_ms, motions = match(default, scans)
    mapping_ms, is_key = draw(DpSlam(DpSlamConfig(), 1), scans, motions)
    return counts, {
        "resample": resampling_ms,
        "match, default": matching_ms,
        "match, Table 1": match(table_1, scans)[0],
        "map, key scans": mapping_ms[is_key],
        "map, all scans": mapping_ms,
    }


def read(log: Path, most: int) -> tuple[Beams, list[Scan]]:
    """Return the beams and the first scans of a log."""
    beams, scans = scans_of(log)
    return beams, list(islice(scans, most))


def resample(resampler: Resampler, scans: list[Scan]) -> tuple[Times, Times]:
    """Return for each scan the time that resampling took, ms, and the number of points left."""
    times_ms, counts = [], []
    for scan in scans:
        began = time.thread_time()
        resampler.points(scan, np.zeros(3))
        means = resampler.means()
        times_ms.append(1e3 * (time.thread_time() - began))
        counts.append(len(means))
    return np.array(times_ms[WARM_UP:]), np.array(counts[WARM_UP:])


def match(config: OdometryConfig, scans: list[Scan]) -> tuple[Times, list[Motion]]:
    """Return the time that the odometry took for each scan, ms, and all motions."""
    odometry = LaserOdometry(config, 1)
    times_ms, motions = [], []
    for scan in scans:
        began = time.thread_time()
        motions.append(odometry.step(scan).motion)
        times_ms.append(1e3 * (time.thread_time() - began))
    return np.array(times_ms[WARM_UP:]), motions


def draw(mapping: DpSlam, scans: list[Scan], motions: list[Motion]) -> tuple[Times, NDArray[np.bool_]]:
    """Return the time that the mapper took for each scan, ms, and which of them it drew."""
    times_ms, drawn = [], []
    for scan, motion in zip(scans, motions, strict=True):
        began = time.thread_time()
        drawn.append(mapping.step(scan, motion).updated)
        times_ms.append(1e3 * (time.thread_time() - began))
    return np.array(times_ms[WARM_UP:]), np.array(drawn[WARM_UP:])


if __name__ == "__main__":
    main()
