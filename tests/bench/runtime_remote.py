"""What guests over a network cost the robot, and what they see, on good wires and bad ones.

    python tests/bench/runtime_remote.py [--seconds 30] [--only WORD]

The demo runs in one network namespace with its door open, guests in another, each of them a session that
takes everything `hallway view` takes, and the map as it does. Between the two is `tests/bench/wire.py`. Each
case prints, in ms, the way of a scan on the robot (first ray to pose published, beyond the sensor's own
revolution), how old poses and scans are when a guest has them (published to received), and the bytes on the
wire for each guest. Then the wire is cut, and mended.
"""

import argparse
import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""As a run's directory is on a robot with systemd: not on a disk that others use."""

from runtime import messages  # noqa: E402
from runtime.access import gate, keys  # noqa: E402
from runtime.bus import links  # noqa: E402
from runtime.bus.contract import Mailbox  # noqa: E402
from runtime.bus.offset import measured  # noqa: E402
from runtime.bus.zenoh_bus import ZenohBus  # noqa: E402
from runtime.clock import Clock  # noqa: E402
from runtime.topics import topic  # noqa: E402

ROBOT = "10.77.32.1"
REVOLUTION_MS = 100.0
GOOD = {"rate_bit_s": 0, "delay_ms": 0, "jitter_ms": 0, "loss": 0, "cut": False}
SLOW = GOOD | {"rate_bit_s": 1_000_000, "delay_ms": 10}
CASES = (
    ("nobody", GOOD, 0, 0),
    ("1 guest", GOOD, 1, 0),
    ("10 guests", GOOD, 10, 0),
    ("10 guests and 1 that is stopped", GOOD, 10, 1),
    ("1 guest, 20 ms +- 10 ms", GOOD | {"delay_ms": 20, "jitter_ms": 10}, 1, 0),
    ("1 guest, 20 ms +- 10 ms, 2 % lost", GOOD | {"delay_ms": 20, "jitter_ms": 10, "loss": 0.02}, 1, 0),
    ("1 guest, 1 Mbit/s", SLOW, 1, 0),
    ("1 guest, 1 Mbit/s, 1 % lost", SLOW | {"loss": 0.01}, 1, 0),
    ("3 guests, 1 Mbit/s", SLOW, 3, 0),
)


def key(name):
    return messages.topic_key(f"robot/{name}", topic(name).type)


# ---- a guest process: `runtime_remote.py --guest SESSIONS` ----


def guest(sessions):
    """Look with some sessions; answer each line on stdin by what was seen since the last."""
    from runtime.nodes.viewing.scene import SUBSCRIBES
    from runtime.process.node import BusPort

    with contextlib.ExitStack() as stack:
        ports = []
        for number in range(sessions):
            port = BusPort(
                f"view_{os.getpid()}_{number}",
                lambda: ZenohBus(gate.visit("robot")),
                subscribes=SUBSCRIBES,
                guest=True,
            )
            stack.enter_context(port)
            inboxes = {name: port.subscribe(name, keep=100_000, raw=True) for name in SUBSCRIBES}
            port.ready()
            ports.append(inboxes)
        print("up", flush=True)
        for _ in sys.stdin:
            seen = {name: [] for name in ("pose", "scan", "map")}
            missed = {}
            for inboxes in ports:
                for name, inbox in inboxes.items():
                    arrived = inbox.drain()
                    missed[name] = missed.get(name, 0) + inbox.missed
                    if name in seen:
                        seen[name] += [
                            (
                                messages.peek_stamp_ns(one.payload),
                                one.published_ns,
                                one.received_ns - port.clock.offset_ns,
                            )
                            for one in arrived
                        ]
            print(json.dumps({"seen": seen, "missed": missed}), flush=True)


# ---- the bench ----


class Bench:
    """The robot, the wire, and the guests."""

    def __init__(self, folder, stack):
        self.folder = Path(folder)
        self.here, self.there = f"hallway-r{os.getpid()}", f"hallway-l{os.getpid()}"
        for name in (self.here, self.there):
            subprocess.run(["ip", "netns", "add", name], check=True)
            stack.callback(subprocess.run, ["ip", "netns", "del", name], check=False)
        command = [sys.executable, str(Path(__file__).with_name("wire.py")), self.here, self.there]
        self.wire = stack.enter_context(self._talk(command, None))
        stack.callback(lambda: self.wire.stdin.close())
        os.environ["HALLWAY_KEYS"] = str(self.folder / "owner")
        keys.make("robot", [ROBOT])
        invitation = keys.invite("robot", "anna", "viewer", ROBOT)
        keys.write_private(self.folder / "anna.invitation", invitation.to_bytes())
        os.environ["HALLWAY_KEYS"] = str(self.folder / "anna")
        keys.pair(self.folder / "anna.invitation")
        self.up = stack.enter_context(self._robot())
        stack.callback(self._end_robot)
        self.run_dir = self.folder / "run" / "robot"
        end = time.monotonic() + 90
        while not (self.run_dir / "hub.sock").exists():
            assert time.monotonic() < end, "the demo did not start"
            time.sleep(0.05)
        self.bus = stack.enter_context(ZenohBus(links.peer(self.run_dir, "bench")))
        self.poses = Mailbox(100_000)
        self.bus.subscribe(key("pose"), self.poses.put)
        while not self.poses.received:
            assert time.monotonic() < end, "no pose came"
            time.sleep(0.05)
        self.offset_ns = Clock().offset_ns + measured(self.bus, "robot", Clock()).offset_ns

    def _talk(self, command, user):
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        if user is not None:
            own = {"HALLWAY_KEYS": str(self.folder / user), "HALLWAY_RUN": str(self.folder / f"{user}-run")}
            environment |= own
        pipe = subprocess.PIPE
        process = subprocess.Popen(command, env=environment, stdin=pipe, stdout=pipe, text=True, bufsize=1)
        assert process.stdout.readline() == "up\n"
        return process

    def _robot(self):
        run, keys_ = str(self.folder / "run"), str(self.folder / "owner")
        environment = {**os.environ, "HALLWAY_RUN": run, "HALLWAY_KEYS": keys_, "PYTHONPATH": str(ROOT)}
        command = ["ip", "netns", "exec", self.here, sys.executable, "-m", "runtime.cli", "up", "demo"]
        command += ["--headless", "--remote", f"{ROBOT}:7448", "--out", str(self.folder / "res")]
        return subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, cwd=ROOT)

    def _end_robot(self):
        self.up.send_signal(signal.SIGINT)
        self.up.wait(60)

    def guests(self, count):
        """Start a process with so many sessions."""
        command = ["ip", "netns", "exec", self.there, sys.executable, __file__, "--guest", str(count)]
        return self._talk(command, "anna")

    def link(self, **settings):
        """Change the wire; return what has gone through it since the last time."""
        self.wire.stdin.write(json.dumps(settings) + "\n")
        return json.loads(self.wire.stdout.readline())

    def ask(self, process):
        """Return what a guest process has seen since it was asked before."""
        process.stdin.write("tell\n")
        return json.loads(process.stdout.readline())

    def robot_ms(self):
        """Return the ways of the scans on the robot since the last time, ms."""
        arrived = self.poses.take_all()
        return [
            (one.attachment.published_ns - messages.peek_stamp_ns(bytes(one.payload))) / 1e6 - REVOLUTION_MS
            for one in arrived
        ]


def spread(values, width=6):
    """Return p50 and p99 in words."""
    if not values:
        return f"{'-':>{width}} {'-':>{width}}"
    p50, p99 = np.percentile(values, (50, 99))
    return f"{p50:{width}.1f} {p99:{width}.1f}"


def measure(bench, case, seconds):
    """Run one case and print its row."""
    case_name, link, count, stopped = case
    with contextlib.ExitStack() as stack:
        bench.link(**link)
        began = time.monotonic()
        lookers = [stack.enter_context(bench.guests(min(5, count - n))) for n in range(0, count, 5)]
        frozen = [stack.enter_context(bench.guests(1)) for _ in range(stopped)]
        for process in (*lookers, *frozen):
            stack.callback(end, process)
        first_map_s = whole_map_after(bench, lookers[0], began) if lookers else None
        time.sleep(2)
        for process in frozen:
            process.send_signal(signal.SIGSTOP)
        bench.link()
        bench.robot_ms()
        for process in lookers:
            bench.ask(process)
        began = time.monotonic()
        time.sleep(seconds)
        took_s = time.monotonic() - began
        counted, robot = bench.link(), bench.robot_ms()
        seen = [bench.ask(process) for process in lookers]
    aged = {
        topic_: [
            (got - bench_ns(bench, published)) / 1e6 for s in seen for _, published, got in s["seen"][topic_]
        ]
        for topic_ in ("pose", "scan")
    }
    each = counted["down"] / took_s / 1e3 / max(1, count)
    lost = {name: sum(one["missed"][name] for one in seen) for name in (seen[0]["missed"] if seen else ())}
    poses = len(aged["pose"]) / max(1, count) / took_s
    print(
        f"| {case_name:34} | {spread(robot)} | {spread(aged['pose'])} | {spread(aged['scan'])} "
        f"| {poses:5.1f} | {each:6.1f} | {'-' if first_map_s is None else f'{first_map_s:.1f}':>5} "
        f"| {os.getloadavg()[0]:4.1f} | {', '.join(f'{n} {name}' for name, n in lost.items() if n) or '-'} |",
        flush=True,
    )


def bench_ns(bench, published_ns):
    """Return a time of the robot's clock by the one that all processes of this machine share."""
    return published_ns - bench.offset_ns


def whole_map_after(bench, looker, began):
    """Return the time from the guest's start to its first map."""
    while time.monotonic() < began + 60:
        if bench.ask(looker)["seen"]["map"]:
            return time.monotonic() - began
        time.sleep(0.1)
    return None


def end(process):
    process.send_signal(signal.SIGCONT)
    process.kill()
    process.stdin.close()
    process.stdout.close()


def cuts(bench, seconds_cut):
    """Cut the wire under a guest and mend it; print when it sees poses again."""
    bench.link(**GOOD)
    with bench.guests(1) as looker:
        try:
            time.sleep(3)
            for cut_s in seconds_cut:
                bench.robot_ms()
                bench.link(cut=True)
                time.sleep(cut_s)
                robot = bench.robot_ms()
                bench.ask(looker)
                bench.link(cut=False)
                mended = time.monotonic()
                fresh_ns = time.monotonic_ns()
                while True:
                    poses = bench.ask(looker)["seen"]["pose"]
                    back = [got for _, published, got in poses if bench_ns(bench, published) > fresh_ns]
                    if back:
                        break
                    assert time.monotonic() < mended + 120, "did not come back"
                    time.sleep(0.05)
                back_s = (back[0] - fresh_ns) / 1e9
                print(
                    f"| cut for {cut_s:4.0f} s | back after {back_s:5.2f} s | {spread(robot)} |", flush=True
                )
        finally:
            end(looker)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--only", default="", metavar="WORD", help="cases whose name has it")
    parser.add_argument("--guest", type=int, metavar="SESSIONS", help="be the guests of a case")
    args = parser.parse_args()
    if args.guest:
        guest(args.guest)
        return
    with tempfile.TemporaryDirectory(prefix="hw", dir=MEMORY) as folder, contextlib.ExitStack() as stack:
        bench = Bench(folder, stack)
        time.sleep(5)
        columns = ("case", "robot p50 p99", "pose p50 p99", "scan p50 p99", "poses/s", "kB/s each")
        print(f"| {' | '.join((*columns, 'first map, s', 'load', 'lost'))} |")
        print("|---|---|---|---|---|---|---|---|---|", flush=True)
        for case in CASES:
            if args.only in case[0]:
                measure(bench, case, args.seconds)
        if args.only in "cut":
            cuts(bench, (1, 5, 15))


if __name__ == "__main__":
    main()
