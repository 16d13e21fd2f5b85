"""What hours of looking cost in memory: a drive's messages, as fast as they can be drawn, to a page.

    python tests/bench/viewer_memory.py --hours 2

Prints one JSON object: MB of the server, of this process, and what the limit was.
"""

import argparse
import importlib.util
import json
import os
import sys
import time
from pathlib import Path

import numpy as np

from runtime.nodes.viewing.scene import Scene
from runtime.nodes.viewing.screen import Screen
from runtime.nodes.viewing.server import ViewerServer

_spec = importlib.util.spec_from_file_location(
    "viewer_story", Path(__file__).parents[1] / "integration" / "viewer_story.py"
)
story = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(story)

LIMIT_MB = 128


def rss_mb(pid: int) -> float:
    """Return the resident memory of a process."""
    pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def messages(scans: int):
    """Yield the messages of a long drive: ten scans and poses a second, a map of 16 m every second."""
    cells = np.zeros((320, 320), dtype=np.int8)
    for k in range(scans):
        at_ns = story.stamp(k) + 110_000_000
        yield story.received("scan", story.scan(k), at_ns)
        yield story.received("match_points", story.cloud(k, np.ones((134, 2))), at_ns + 1)
        yield story.received("odom", story.odom(k), at_ns + 2)
        yield story.received("pose", story.pose(k), at_ns + 3)
        if k % 10 == 0:
            cells[(k // 10) % 320] = k % 100
            yield story.received("map", story.grid(k, cells), at_ns + 4)
            yield story.received("particles", story.particles(k), at_ns + 5)
            yield story.received("diagnostics", story.diagnostics(k, "matcher", state="TRACKING"), at_ns + 6)


def main() -> int:
    """Draw; 1 if the server outgrew its limit by more than half and BENCH_STRICT is set."""
    parser = argparse.ArgumentParser(description="Measure the memory of a long look.")
    parser.add_argument("--hours", type=float, default=2.0)
    args = parser.parse_args()
    scans = round(args.hours * 36_000)
    server = ViewerServer(web=True, port=29890, web_port=29891, memory_mb=LIMIT_MB)
    try:
        screen = Screen("bench", url=server.url)
        scene = Scene("robot", lambda kind, draw: draw(screen))
        marks: list[tuple[float, float]] = []
        began = time.monotonic()
        for number, received in enumerate(messages(scans)):
            scene.take(received)
            if number % 50_000 == 0:
                marks.append((round(rss_mb(server._process.pid), 1), round(rss_mb(os.getpid()), 1)))
        marks.append((round(rss_mb(server._process.pid), 1), round(rss_mb(os.getpid()), 1)))
        took_s = time.monotonic() - began
    finally:
        server.close()
    peak = max(mark[0] for mark in marks)
    result = {"bench": "viewer_memory", "hours": args.hours, "limit_mb": LIMIT_MB, "server_peak_mb": peak}
    result |= {
        "own_end_mb": marks[-1][1],
        "marks_mb": marks[:: max(1, len(marks) // 8)],
        "s": round(took_s, 1),
    }
    print(json.dumps(result))
    return int(bool(os.environ.get("BENCH_STRICT")) and peak > 1.5 * LIMIT_MB + 100)


if __name__ == "__main__":
    sys.exit(main())
