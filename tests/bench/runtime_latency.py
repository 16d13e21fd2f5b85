"""From the first ray to the published pose in the running demo, scan by scan, exactly.

    python tests/bench/runtime_latency.py [--seconds 60] [--graph demo] [--fifo]

Every message carries the stamp of its scan and the time it was published, so nothing is measured but read.
The sensor's own revolution (100 ms from the first ray to the last) is taken off the whole way; the target
is a p99 under 100 ms beyond it. The very first scan is told beside it: everything is compiled and warm before
the laser starts, so it shall be no later than the others. `--fifo` gives laser and matcher the real-time
scheduler, as a robot that allows it.
"""

import argparse
import json
import os
import signal
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from robot_run import started

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from runtime import config, graph, messages  # noqa: E402
from runtime.bus import links  # noqa: E402
from runtime.bus.contract import Mailbox  # noqa: E402
from runtime.bus.zenoh_bus import ZenohBus  # noqa: E402
from runtime.topics import topic  # noqa: E402

REVOLUTION_MS = 100.0
FIRST = 20


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--graph", default="demo")
    parser.add_argument("--fifo", action="store_true")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hw") as folder:
        file = prepared(args, Path(folder))
        with started(file, folder, "--headless") as up:
            try:
                published = watch(Path(folder) / "run" / "robot", args.seconds)
            finally:
                began = time.monotonic()
                up.send_signal(signal.SIGINT)
                up.wait(60)
                stop_s = time.monotonic() - began
        metrics = json.loads((Path(folder) / "res" / "metrics.json").read_text())
    report(published, metrics, stop_s)


def prepared(args, folder):
    """Return the graph, with real-time priorities if asked."""
    file = graph.find(args.graph)
    if not args.fifo:
        return file
    data = config.load_yaml(file)
    data["nodes"]["laser"]["priority"] = 20
    data["nodes"]["matcher"]["priority"] = 10
    (folder / "fifo.yaml").write_text(config.to_yaml(data))
    return folder / "fifo.yaml"


def watch(run_dir, seconds):
    """Return for each topic the time it was published, ns, by the stamp of its scan."""
    end = time.monotonic() + 60
    while not (run_dir / "hub.sock").exists():
        assert time.monotonic() < end, "the demo did not start"
        time.sleep(0.05)
    boxes = {name: Mailbox(100_000) for name in ("scan", "odom", "pose")}
    with ZenohBus(links.visitor(run_dir)) as bus:
        for name, box in boxes.items():
            bus.subscribe(messages.topic_key(f"robot/{name}", topic(name).type), box.put)
        while not boxes["pose"].received:
            assert time.monotonic() < end, "no pose came"
            time.sleep(0.05)
        time.sleep(seconds)
    return {
        name: {
            messages.peek_stamp_ns(bytes(one.payload)): one.attachment.published_ns for one in box.take_all()
        }
        for name, box in boxes.items()
    }


def report(published, metrics, stop_s):
    """Print one line a hop and one object for machines."""
    scan, odom, pose = published["scan"], published["odom"], published["pose"]
    stamps = sorted(set(scan) & set(odom) & set(pose))
    ms = {
        "scan_beyond_revolution": [(scan[s] - s) / 1e6 - REVOLUTION_MS for s in stamps],
        "match": [(odom[s] - scan[s]) / 1e6 for s in stamps],
        "map": [(pose[s] - odom[s]) / 1e6 for s in stamps],
        "whole_beyond_revolution": [(pose[s] - s) / 1e6 - REVOLUTION_MS for s in stamps],
    }
    results = {
        "scans": len(scan),
        "posed": len(stamps),
        "late": metrics["latency"]["late"],
        "stop_s": round(stop_s, 2),
        "load": [round(value, 1) for value in os.getloadavg()],
    }
    for hop, values in ms.items():
        p50, p99, worst = np.percentile(values, (50, 99, 100))
        early = max(values[:FIRST])
        results[hop] = {
            "first": round(values[0], 2),
            "p50": round(p50, 2),
            "p99": round(p99, 2),
            "max": round(worst, 2),
        }
        line = f"{hop:26} p50 {p50:7.2f}  p99 {p99:7.2f}  max {worst:7.2f} ms"
        print(f"{line}   the first scan {values[0]:.1f}, worst of the first {FIRST}: {early:.1f}")
    print(json.dumps({"bench": "runtime_latency", "unit": "ms", **results}))


if __name__ == "__main__":
    main()
