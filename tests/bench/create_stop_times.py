"""Time from a fault to zeros on the robot's wire: `python tests/bench/create_stop_times.py [--runs 100]`.

For each fault the real chain drives (`hallway up`, base node, watchdog, `hallway teleop` with a key held),
one thing is killed, stopped or cut, and the first zeros on the wire after which no motion was commanded are
timed. Prints median, p99 and maximum in ms, and one JSON line; leaves with 1 if a maximum is over 350 ms.
"""

import argparse
import contextlib
import importlib.util
import json
import os
import sys
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
LIMIT_MS = 350.0

sys.path.insert(0, str(ROOT))
_path = ROOT / "tests" / "integration" / "create_stage.py"
_spec = importlib.util.spec_from_file_location("create_stage", _path)
create_stage = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(create_stage)


def measure(cut, runs):
    """Return the times (runs,) in ms."""
    with contextlib.ExitStack() as stack:
        network = stack.enter_context(create_stage.Network()) if cut == "network" else None
        stage = stack.enter_context(create_stage.Stage(network))
        times = []
        for run in range(runs):
            times.append(stage.cut(cut))
            print(f"\r{cut}: {run + 1}/{runs}", end="", file=sys.stderr, flush=True)
        print(file=sys.stderr)
        return np.array(times)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=100)
    parser.add_argument("--cuts", nargs="+", default=create_stage.CUTS, choices=create_stage.CUTS)
    args = parser.parse_args()
    results = {}
    print(f"{'fault':14} {'runs':>5} {'median':>8} {'p99':>8} {'max':>8}   ms to zeros on the wire")
    for cut in args.cuts:
        times = measure(cut, args.runs)
        median, p99, worst = np.percentile(times, (50, 99, 100))
        results[cut] = {"median": round(median, 1), "p99": round(p99, 1), "max": round(worst, 1)}
        print(f"{cut:14} {len(times):5d} {median:8.1f} {p99:8.1f} {worst:8.1f}", flush=True)
    load = os.getloadavg()[0]
    print(
        json.dumps({"bench": "create_stop_times", "unit": "ms", "runs": args.runs, "load": load, **results})
    )
    return int(any(result["max"] > LIMIT_MS for result in results.values()))


if __name__ == "__main__":
    sys.exit(main())
