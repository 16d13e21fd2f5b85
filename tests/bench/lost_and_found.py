"""Kidnap the laser in real logs: how soon is it known, where is it found again, and is that true?

    python tests/bench/lost_and_found.py ../shared/data/exp1.dat ../shared/data/intel.clf.bz2

The pipeline maps a log; at several moments it is copied, scans are cut out, and the copy goes on for a while:
`forward`, ten seconds later, mostly on ground that it has never seen; `back`, somewhere on the way so far.
Truth is the path of the run without a cut.
"""

import argparse
import pickle
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[2]))

from processing.odometry import Tracking
from processing.scan import Scan
from processing.se2 import between
from processing.slam import Slam
from runtime.nodes.log_scans import scans_of

CUT_S = 10.0
FOLLOWED_S = 30.0
NEAR_M, NEAR_RAD = 0.5, 0.2
"""A pose farther off than this is wrong."""
HEAD = (
    f"{'':29} LOST after, s   taken up     found by odometry     found by mapper     at the end\n"
    f"{'log':15}{'cut':9}{'n':>5}{'p50':>7}{'max':>7}  right wrong      right wrong   right wrong  p50 s"
    "  right lost wrong"
)


@dataclass
class Case:
    """What one kidnapping led to."""

    way_m: float
    noticed_s: float = np.inf
    """When the track counted as lost, after the last scan before the cut; infinite: never."""
    claims: list[tuple[str, float, bool]] = field(default_factory=list)
    """Each time a pose was claimed again: by whom ('nobody' when nothing was noticed), when, and rightly?"""
    end: str = ""
    """What it says at the end: 'right', 'wrong' or 'lost'."""


def main() -> None:
    """Kidnap in every log named on the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("logs", type=Path, nargs="+")
    parser.add_argument("--times", type=int, default=12, help="kidnappings of each kind and log")
    parser.add_argument("--scans", type=int, default=3000, help="use the first ones of a log only")
    parser.add_argument("--cases", action="store_true", help="a line for each kidnapping, too")
    args = parser.parse_args()
    print(HEAD, flush=True)
    for log in args.logs:
        scans = [scan for _, scan in zip(range(args.scans), scans_of(log)[1], strict=False)]
        for kind, cases in kidnap(scans, args.times).items():
            print(row(log.name, kind, list(cases.values())), flush=True)
            for (at, to), case in cases.items() if args.cases else ():
                print("   ", at, to, case)


def kidnap(scans: list[Scan], times: int) -> dict[str, dict[tuple[int, int], Case]]:
    """Map the scans, and kidnap so often forward and so often back."""
    cut = round(CUT_S / scans[0].beams.period_s)
    last = min(0.85 * len(scans), len(scans) - 1.5 * cut)
    moments = set(np.linspace(0.15 * len(scans), last, times).astype(int).tolist())
    kept: dict[int, bytes] = {}
    slam = Slam(seed=1)
    lost = 0
    for number, scan in enumerate(scans):
        if number in moments:
            kept[number] = pickle.dumps(slam)
        lost += slam.step(scan).match.state is Tracking.LOST
    slam.finish()
    path = slam.trajectory()[1]
    if lost:
        print(f"    {lost} scans LOST without a kidnapping")
    random = np.random.default_rng(1)
    cases: dict[str, dict[tuple[int, int], Case]] = {"forward": {}, "back": {}}
    for at, copy in kept.items():
        back = elsewhere(path, at, random)
        for kind, to in (("forward", at + cut), ("back", back)):
            cases[kind][at, to] = follow(pickle.loads(copy), scans, path, at, to)
    return cases


def elsewhere(path: np.ndarray, at: int, random: np.random.Generator) -> int:
    """Return a scan in the first half of the way to `at`, at least two metres away, if there is one."""
    away = np.hypot(*(path[: at // 2, :2] - path[at, :2]).T)
    return int(random.choice(np.flatnonzero(away > min(2.0, 0.9 * away.max()))))


def follow(slam: Slam, scans: list[Scan], path: np.ndarray, at: int, to: int) -> Case:
    """Go on with the scans from `to` on, after those before `at`."""
    period_s = scans[0].beams.period_s
    last = slam.mapping.trajectory()[1][-1]
    way = between(path[at - 1], path[to])
    case = Case(float(np.hypot(way[0], way[1])))
    claimed, by = False, "nobody"
    for k in range(to, min(to + round(FOLLOWED_S / period_s), len(scans))):
        # By the stamps the cut takes no time; that the laser moved is for the scans to tell.
        stamp_ns = scans[at - 1].stamp_ns + round((k - to + 1) * period_s * 1e9)
        step = slam.step(Scan(stamp_ns, scans[k].ranges_m, scans[k].beams))
        after_s = (k - to + 1) * period_s
        if step.match.state is Tracking.LOST:
            case.noticed_s = min(case.noticed_s, after_s)
        if step.mapping.lost:
            by = "mapper" if by == "mapper" or not step.match.motion.lost else "odometry"
            claimed, case.end = False, "lost"
            continue
        off = np.abs(between(between(path[at - 1], path[k]), between(last, step.mapping.map_t_laser)))
        right = bool(np.hypot(off[0], off[1]) < NEAR_M and off[2] < NEAR_RAD)
        case.end = "right" if right else "wrong"
        by = "mapper" if step.match.motion.anew else by
        if not claimed:
            case.claims.append((by, after_s, right))
        claimed, by = True, "nobody"
    return case


def row(log: str, kind: str, cases: list[Case]) -> str:
    """Return the line of the table for the kidnappings of one kind."""
    noticed = [case.noticed_s for case in cases if np.isfinite(case.noticed_s)] or [np.nan]
    claims = [claim for case in cases for claim in case.claims]

    def count(by: str, right: bool) -> int:
        return sum(claim[0] == by and claim[2] == right for claim in claims)

    found_s = [when for by, when, right in claims if by == "mapper" and right] or [np.nan]
    ends = [case.end for case in cases]
    return (
        f"{log[:14]:15}{kind:9}{len(cases):>5}{np.median(noticed):>7.2f}{max(noticed):>7.2f}"
        f"{count('nobody', True):>7}{count('nobody', False):>6}"
        f"{count('odometry', True):>11}{count('odometry', False):>6}"
        f"{count('mapper', True):>8}{count('mapper', False):>6}{np.median(found_s):>7.1f}"
        f"{ends.count('right'):>7}{ends.count('lost'):>5}{ends.count('wrong'):>6}"
    )


if __name__ == "__main__":
    main()
