"""As many robots as this machine carries at one zenoh router: what they cost it, and what a person sees.

    python tests/bench/many_robots.py [--robots 1 10 50 100] [--seconds 10] [--everything]

A robot is a session that publishes what the demo's processes publish, in sizes and rates as measured in a
recording, and declares as many liveliness tokens. The router is a process of its own. A person looks at one
robot with everything that `hallway view` takes, and a wall shows where all robots are (every `pose`). With
`--everything` somebody takes every topic of every robot, as a recorder of all would.
"""

import argparse
import contextlib
import heapq
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from runtime import messages  # noqa: E402
from runtime.bus import links  # noqa: E402
from runtime.bus.zenoh_bus import ZenohBus  # noqa: E402
from runtime.nodes.viewing.scene import SUBSCRIBES  # noqa: E402
from runtime.topics import TOPICS  # noqa: E402

STREAMS = {  # Hz and bytes, as `hallway info` finds them in a recording of a minute of the demo
    "scan": (10, 2788),
    "odom": (10, 716),
    "match_points": (10, 1693),
    "pose": (10, 364),
    "tf": (20, 96),
    "diagnostics": (9, 1251),
    "map_updates": (2.4, 9597),
    "map": (0.12, 55912),
    "particles": (1.6, 2828),
    "trajectory": (0.2, 21649),
    "battery": (1, 81),
    "cmd_vel": (10, 76),
}
TOKENS = 45
"""Of the demo: a node's and those of its publishers and subscriptions."""
PER_PROCESS = 25
PORT = 7460


def key(robot, name):
    return messages.topic_key(f"{robot}/{name}", TOPICS[name].type)


def client():
    return links.merged(links.BASE, {"mode": "client", "connect": {"endpoints": [f"tcp/127.0.0.1:{PORT}"]}})


# ---- the processes ----


def router():
    """Be the router until stdin ends."""
    config = {"mode": "router", "listen": {"endpoints": [f"tcp/127.0.0.1:{PORT}"]}}
    with ZenohBus(links.merged(links.BASE, config)):
        print("up", flush=True)
        sys.stdin.read()


def robots(first, count):
    """Be some robots until stdin ends; then tell how late the worst message left."""
    import threading

    over = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), over.set()), daemon=True).start()
    with contextlib.ExitStack() as stack:
        queue, sent = [], 0
        rng = np.random.default_rng(first)
        for number in range(first, first + count):
            bus = stack.enter_context(ZenohBus(client()))
            for token in range(TOKENS):
                bus.token(messages.node_token(bus.zid, f"r{number}", f"n{token}"))
            for name, (rate_hz, size) in STREAMS.items():
                publisher = bus.publisher(key(f"r{number}", name), urgency=TOPICS[name].urgency)
                due = time.monotonic() + rng.random() / rate_hz
                heapq.heappush(
                    queue, [due, len(queue), 1 / rate_hz, publisher, bytes(size), os.urandom(16), 0]
                )
        print("up", flush=True)
        worst_s = 0.0
        while not over.is_set():
            entry = queue[0]
            wait_s = entry[0] - time.monotonic()
            if wait_s > 0:
                time.sleep(min(wait_s, 0.05))
                continue
            worst_s = max(worst_s, -wait_s)
            entry[0] += entry[2]
            entry[6] += 1
            sent += 1
            entry[3].put(entry[4], messages.Attachment(entry[6], time.monotonic_ns(), entry[5]).encode())
            heapq.heapreplace(queue, entry)
        print(json.dumps({"sent": sent, "worst_s": worst_s}), flush=True)


def start(stack, *arguments):
    """Start one of the processes above."""
    pipe = subprocess.PIPE
    command = [sys.executable, __file__, *map(str, arguments)]
    process = subprocess.Popen(
        command, stdin=pipe, stdout=pipe, text=True, env=os.environ | {"PYTHONPATH": str(ROOT)}
    )
    stack.callback(process.kill)
    assert process.stdout.readline() == "up\n"
    return process


# ---- the bench ----


class Watcher:
    """Takes messages, and keeps how old they were and how large."""

    def __init__(self):
        self.ages_ms, self.missed, self._last = [], 0, {}

    def take(self, arrival):
        attachment = arrival.attachment
        self.ages_ms.append((arrival.received_monotonic_ns - attachment.published_ns) / 1e6)
        last = self._last.get(attachment.gid)
        if last is not None:
            self.missed += max(0, attachment.sequence - last - 1)
        self._last[attachment.gid] = attachment.sequence

    def reset(self):
        self.ages_ms, self.missed = [], 0

    def words(self, seconds):
        if not self.ages_ms:
            return f"{0:7.0f} {'-':>6} {'-':>6} {0:6}"
        p50, p99 = np.percentile(self.ages_ms, (50, 99))
        return f"{len(self.ages_ms) / seconds:7.0f} {p50:6.1f} {p99:6.1f} {self.missed:6}"


def cpu_s(pid):
    fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def rss_mb(pid):
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6


def measure(count, args):
    """Run one fleet and print its row."""
    with contextlib.ExitStack() as stack:
        hub = start(stack, "--router")
        alone_mb = rss_mb(hub.pid)
        fleet = [
            start(stack, "--fleet", first, min(PER_PROCESS, count - first))
            for first in range(0, count, PER_PROCESS)
        ]
        person, wall, everything = Watcher(), Watcher(), Watcher()
        bus = stack.enter_context(ZenohBus(client()))
        for name in SUBSCRIBES:
            if name in STREAMS:
                bus.subscribe(key("r0", name), person.take)
        second = stack.enter_context(ZenohBus(client()))
        second.subscribe(key("*", "pose"), wall.take)
        if args.everything:
            third = stack.enter_context(ZenohBus(client()))
            third.subscribe("0/**", everything.take)
        time.sleep(2)
        for watcher in (person, wall, everything):
            watcher.reset()
        began, before_s = time.monotonic(), cpu_s(hub.pid)
        time.sleep(args.seconds)
        took_s = time.monotonic() - began
        busy = 100 * (cpu_s(hub.pid) - before_s) / took_s
        rows = [watcher.words(took_s) for watcher in (person, wall, everything)]
        asked = time.monotonic()
        tokens = len(bus.tokens("@ros2_lv/**", timeout_s=20.0))
        tokens_s = time.monotonic() - asked
        hub_mb = rss_mb(hub.pid) - alone_mb
        late_s = 0.0
        for process in fleet:
            out, _ = process.communicate(timeout=60)
            late_s = max(late_s, json.loads(out)["worst_s"])
    print(
        f"| {count:6} | {rows[0]} | {rows[1]} | {rows[2] if args.everything else '-':>28} | {busy:5.0f} "
        f"| {hub_mb:6.1f} | {tokens:6} in {tokens_s:5.2f} s | {late_s * 1e3:5.0f} "
        f"| {os.getloadavg()[0]:4.1f} |",
        flush=True,
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, nargs="+", default=[1, 10, 50, 100])
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--everything", action="store_true")
    parser.add_argument("--router", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--fleet", type=int, nargs=2, help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.router:
        router()
    elif args.fleet:
        robots(*args.fleet)
    else:
        kb = sum(rate * (size + 33) for rate, size in STREAMS.values()) / 1e3
        print(f"a robot publishes {kb:.0f} kB/s in {sum(r for r, _ in STREAMS.values()):.0f} messages/s")
        ages = "messages/s, age p50 p99 ms, missed"
        print(
            f"| robots | one robot: {ages} | all poses: {ages} | everything: {ages} | router CPU % "
            "| router + MB | tokens | worst late ms | load |"
        )
        print("|---|---|---|---|---|---|---|---|---|", flush=True)
        for count in args.robots:
            measure(count, args)


if __name__ == "__main__":
    main()
