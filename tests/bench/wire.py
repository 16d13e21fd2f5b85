"""A wire between two network namespaces with a rate, delay, jitter and loss, for machines without `netem`.

    python tests/bench/wire.py ROBOT_NS LAPTOP_NS      and then one JSON object a line on stdin:
    {"rate_bit_s": 1e6, "delay_ms": 20, "jitter_ms": 10, "loss": 0.02, "cut": false}

Each line is answered by the bytes that have gone through since the last one, in both directions, and the
packets dropped. Packets pass through this process by two TUN devices, in order; what waits for the rate is
at most QUEUE_S of it, as in an access point that is not too bad.
"""

import collections
import fcntl
import json
import os
import random
import select
import struct
import subprocess
import sys
import time

ROBOT, LAPTOP = "10.77.32.1", "10.77.32.2"
QUEUE_S = 0.25
MTU = 1500
_TUNSETIFF, _TUN, _NO_INFO = 0x400454CA, 0x0001, 0x1000


def device(name, namespace, own, other):
    """Make a TUN device in a namespace; return its file."""
    fd = os.open("/dev/net/tun", os.O_RDWR | os.O_NONBLOCK)
    fcntl.ioctl(fd, _TUNSETIFF, struct.pack("16sH", name.encode(), _TUN | _NO_INFO))
    for command in (
        ("link", "set", name, "netns", namespace),
        ("-n", namespace, "addr", "add", own, "peer", other, "dev", name),
        ("-n", namespace, "link", "set", name, "mtu", str(MTU), "up"),
        ("-n", namespace, "link", "set", "lo", "up"),
    ):
        subprocess.run(["ip", *command], check=True)
    return fd


class Lane:
    """One direction."""

    def __init__(self):
        self.waiting = collections.deque()
        self.free_at = self.last_due = 0.0
        self.bytes = self.dropped = 0

    def take(self, packet, now, link, rng):
        """Queue a packet, or lose it."""
        self.free_at = max(self.free_at, now)
        full = link["rate_bit_s"] and self.free_at - now > QUEUE_S
        if link["cut"] or full or rng.random() < link["loss"]:
            self.dropped += 1
            return
        if link["rate_bit_s"]:
            self.free_at += 8 * len(packet) / link["rate_bit_s"]
        delay_s = max(0.0, rng.gauss(link["delay_ms"], link["jitter_ms"])) / 1e3
        # In order: a wire does not overtake itself, and TCP would take that for loss.
        self.last_due = max(self.last_due, self.free_at + delay_s)
        self.waiting.append((self.last_due, packet))

    def give(self, fd, now):
        """Let through what is due."""
        while self.waiting and self.waiting[0][0] <= now:
            _, packet = self.waiting.popleft()
            self.bytes += len(packet)
            try:
                os.write(fd, packet)
            except OSError:
                self.dropped += 1


def main():
    link = {"rate_bit_s": 0.0, "delay_ms": 0.0, "jitter_ms": 0.0, "loss": 0.0, "cut": False}
    robot = device("hwr", sys.argv[1], ROBOT, LAPTOP)
    laptop = device("hwl", sys.argv[2], LAPTOP, ROBOT)
    lanes = {robot: Lane(), laptop: Lane()}
    out = {robot: laptop, laptop: robot}
    rng = random.Random(1)
    print("up", flush=True)
    while True:
        due = min((lane.waiting[0][0] for lane in lanes.values() if lane.waiting), default=None)
        wait_s = 1.0 if due is None else max(0.0, due - time.monotonic())
        ready, _, _ = select.select([robot, laptop, sys.stdin], [], [], wait_s)
        now = time.monotonic()
        for fd in ready:
            if fd is sys.stdin:
                line = sys.stdin.readline()
                if not line:
                    return
                link.update(json.loads(line))
                counts = {"down": lanes[robot].bytes, "up": lanes[laptop].bytes}
                counts["dropped"] = sum(lane.dropped for lane in lanes.values())
                print(json.dumps(counts), flush=True)
                for lane in lanes.values():
                    lane.bytes = lane.dropped = 0
            else:
                for _ in range(64):
                    try:
                        packet = os.read(fd, 65536)
                    except BlockingIOError:
                        break
                    lanes[fd].take(packet, now, link, rng)
        now = time.monotonic()
        for fd, lane in lanes.items():
            lane.give(out[fd], now)


if __name__ == "__main__":
    main()
