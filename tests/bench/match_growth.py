"""How a match grows: CPU time against points, population, cell size, and points of the reference.

    python tests/bench/match_growth.py [--times N]

One step of the simulated demo drive of a URG-04LX: the local map of 20 sweeps, and the sweep after them, its
start 5 cm and 3 degrees off. `build` makes the reference, `DE` searches (no early end: all generations run),
`polish` is Newton's method from the true pose's neighbourhood. Medians, CPU us of the one thread, warm.
"""

import argparse
import time
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from odometry_courses import simulated

from processing.evolution import EvolutionConfig
from processing.matching import Matcher, MatchingConfig
from processing.ndt import Ndt, NdtConfig
from processing.prediction import Prior
from processing.saliency import Resampler, ResamplingConfig
from processing.se2 import between, compose, transform

FIRST, SWEEPS, EVERY = 250, 20, 5
WEAK = np.diag((1 / 0.1**2, 1 / 0.1**2, 1 / 0.1**2))
OFF = np.array((0.04, -0.03, 0.05))


def scene(course, points, sweeps=SWEEPS):
    """Points (N, 2) of a local map, those of the next sweep (M, 2), and where it truly lies."""
    resampler = Resampler(ResamplingConfig(points=points), course.scans[0].beams)
    chosen = range(FIRST - sweeps * EVERY, FIRST, EVERY)
    seen = []
    for k in (*chosen, FIRST):
        sweep_s = course.scans[k].beams.sweep_s
        twist = between(course.truth[k], course.truth[k + 1]) / course.scans[k].beams.period_s
        resampler.points(course.scans[k], twist, 0.5 * sweep_s)
        middle = compose(course.truth[k], twist * 0.5 * sweep_s)
        seen.append((middle, resampler.means()))
    here = seen[0][0]
    local = np.concatenate([transform(between(here, pose), points) for pose, points in seen[:-1]])
    return local, seen[-1][1], between(here, seen[-1][0])


def median_us(act, times) -> float:
    """Median CPU time of calls, us."""
    act()
    took = []
    for _ in range(times):
        began = time.thread_time_ns()
        act()
        took.append(time.thread_time_ns() - began)
    return float(np.median(took)) / 1e3


def line(scene_, search, ndt_config, times) -> tuple[str, ...]:
    """Cells of a row: points, build, DE, polish, all, error."""
    local, points, truth = scene_
    ndt = Ndt(ndt_config)
    search = replace(search, spread=(0.0, 0.0, 0.0))
    both = Matcher(MatchingConfig(search=search), 1)
    polish = Matcher(MatchingConfig(search=replace(search, generations=0)), 1)
    found = Matcher(MatchingConfig(search=search, polish=False), 1)
    start, near = Prior(truth + OFF, WEAK), Prior(truth + 0.2 * OFF, WEAK)
    built = median_us(lambda: ndt.build(local), times)
    searched = median_us(lambda: found.match(points, ndt, start), times)
    polished = median_us(lambda: polish.match(points, ndt, near), times)
    off = between(truth, both.match(points, ndt, start).pose)
    return (
        str(len(local)),
        str(len(points)),
        f"{built:.0f}",
        f"{searched:.0f}",
        f"{polished:.0f}",
        f"{built + searched + polished:.0f}",
        f"{1e3 * np.hypot(off[0], off[1]):.1f} mm, {abs(np.degrees(off[2])):.2f} deg",
    )


def tables(course, times) -> Iterator[tuple[str, list[tuple[str, ...]]]]:
    """Name of a table, and its rows."""
    search, ndt = EvolutionConfig(), NdtConfig()
    usual = scene(course, ResamplingConfig().points)
    yield (
        "points of a sweep",
        [(str(n or "all"), *line(scene(course, n), search, ndt, times)) for n in (30, 60, 134, 250, 400, 0)],
    )
    yield (
        "sweeps in the local map",
        [(str(n), *line(scene(course, 134, n), search, ndt, times)) for n in (1, 5, 20, 45)],
    )
    yield (
        "population x generations",
        [
            (f"{n} x {g}", *line(usual, replace(search, population=n, generations=g), ndt, times))
            for n, g in ((10, 30), (20, 30), (40, 30), (40, 60), (100, 50), (200, 50), (400, 50))
        ],
    )
    yield (
        "cell, m",
        [
            (f"{side:g}", *line(usual, search, cells(ndt, side), times))
            for side in (0.125, 0.25, 0.5, 1.0, 2.0)
        ],
    )


def cells(ndt, side_m) -> NdtConfig:
    """One size of cells, and no other."""
    return replace(ndt, cell_m=side_m, fine_cell_m=0.0)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--times", type=int, default=100, help="calls of which the median is taken")
    args = parser.parse_args()
    course = simulated("demo")
    for name, rows in tables(course, args.times):
        print(f"\n| {name} | in the map | matched | build us | DE us | polish us | all us | error |")
        print("|---|---|---|---|---|---|---|---|")
        for row in rows:
            print(f"| {' | '.join(row)} |", flush=True)


if __name__ == "__main__":
    main()
