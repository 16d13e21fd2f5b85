"""The demo for hours: does anything grow, slow down, or get lost?

    python tests/bench/soak.py [--hours 1] [--every 300] [--with recorder viewer]
    python tests/bench/soak.py --speed 8 --hours 3          (a simulated day)

Every `--every` seconds one row for each process: resident memory, file descriptors, threads, and what it
lost; and the way of a scan (first ray to pose, beyond the sensor's revolution) in that time.

With `--speed` the same drive comes from the same world in simulated time, so many times faster, without the
emulated devices: to the live matcher and mapper, for `--hours` of ours. The way of a scan then begins when it
is published.

At the end: the p99 of the way in the first and the last tenth since the map has stopped growing (a key scan
on new ground is a quarter cheaper: there is no old map to weigh the particles by), and for each process the
slope of its memory over the second half, in MB an hour of the drive, without what the maps of all particles
hold. Leaves with 1 if the last p99 is more than a tenth above the first, or memory, files or threads grow;
what a run is too short to tell is said and not judged.
"""

import argparse
import json
import os
import signal
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
from robot_run import started

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""As a run's directory is on a robot with systemd: not on a disk that others use."""

from drivers import world  # noqa: E402
from drivers.world.drive import simulate_scans  # noqa: E402
from processing.scan import Scan  # noqa: E402
from runtime import config, graph, messages  # noqa: E402
from runtime.bus import links  # noqa: E402
from runtime.bus.contract import Mailbox  # noqa: E402
from runtime.bus.zenoh_bus import ZenohBus  # noqa: E402
from runtime.cli.study import drives  # noqa: E402
from runtime.nodes.convert import scan_to_message  # noqa: E402
from runtime.process.health import Health  # noqa: E402
from runtime.process.node import BusPort  # noqa: E402
from runtime.topics import topic  # noqa: E402

REVOLUTION_MS = 100.0
P99_RATIO = 1.10
POSES_MIN = 300
"""In a tenth; of fewer the p99 is the worst two or three, which is luck."""
GROWS_MB_H = 4.0
"""Beyond what the maps of all particles take, which the mapper says of itself."""
GROWS_HANDLES = 2
DRIVEN_MIN_H = 0.15
"""Of the half that is judged; in less the steps of the allocator are steeper than any growth."""
AREA_GROWS = 0.01
"""The map is whole when it grows no more than that from one look to the next."""
NOT_ON_A_ROBOT = ("simulator",)
SAMPLE_S = 10.0
SENSORS = ("simulator", "base", "operator", "laser")
EXTRA = {
    "recorder": {"module": "recorder", "required": False, "config": {"recording": {"ring_s": 120}}},
    "viewer": {"module": "viewer", "required": False, "nice": 10, "config": {"mode": "web"}},
}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--every", type=float, default=300.0, metavar="S")
    parser.add_argument("--speed", type=float, default=1.0, metavar="N", help="N times real time, simulated")
    parser.add_argument("--with", dest="extra", nargs="*", default=["recorder"], choices=list(EXTRA))
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hw", dir=MEMORY) as folder:
        data = config.load_yaml(graph.find("demo"))
        for name in ("viewer", *(SENSORS if args.speed != 1 else ())):
            del data["nodes"][name]
        data["nodes"] |= {name: EXTRA[name] for name in args.extra}
        file = Path(folder) / "soak.yaml"
        file.write_text(config.to_yaml(data))
        options = [] if "viewer" in args.extra else ["--headless"]
        with started(file, folder, *options) as up:
            try:
                watch = Watch(Path(folder) / "run" / "robot", up.pid, args)
            finally:
                began = time.monotonic()
                up.send_signal(signal.SIGINT)
                code = up.wait(300)
                stop_s = time.monotonic() - began
        metrics = json.loads((Path(folder) / "res" / "metrics.json").read_text())
    return report(watch, metrics, args.speed, code, stop_s)


class Feed(threading.Thread):
    """The laser of a robot that drives round and round in simulated time, faster than the clock.

    Args:
        run_dir: Of the robot whose laser it is.
        speed: Times real time.
    """

    def __init__(self, run_dir, speed):
        super().__init__(name="feed")
        self.sent_ns = {}
        """When a scan was published, by its stamp."""
        self._run_dir, self._speed = run_dir, speed
        self._stopping = threading.Event()

    def run(self):
        beams = drives.drive("floor", 1, 1).scans[0].beams
        around = simulate_scans(world.demo_building(), laps=10**9, seed=1)
        with BusPort("laser", self._join, publishes=("scan",)) as port:
            port.ready()
            first_ns, began = port.clock.now_ns(), time.monotonic()
            for number, (_, ranges_m, _) in enumerate(around):
                due = began + number * beams.period_s / self._speed
                if self._stopping.wait(max(0.0, due - time.monotonic())):
                    return
                stamp_ns = first_ns + round(number * beams.period_s * 1e9)
                message = scan_to_message(Scan(stamp_ns, ranges_m, beams))
                self.sent_ns[stamp_ns] = port.clock.now_ns()
                port.publish("scan", message)

    def _join(self):
        return ZenohBus(links.peer(self._run_dir, "laser"))

    def stop(self):
        self._stopping.set()
        self.join()


class Watch:
    """Looks on until the time is over.

    Attributes:
        samples: (s, {process: (rss_mb, fds, threads, map_mb)}, known cells of the map) each.
        ways_ms: From the first ray to the pose without the revolution, or from the scan to the pose.
        complete: How many of them there were when the map last grew.
    """

    def __init__(self, run_dir, up, args):
        self.samples, self.ways_ms, self.complete = [], [], 0
        self._rows = 0
        end = time.monotonic() + 90
        while not (run_dir / "hub.sock").exists():
            assert time.monotonic() < end, "the demo did not start"
            time.sleep(0.1)
        with ZenohBus(links.peer(run_dir, "soak")) as bus:
            self._health, self._poses, self._maps = Health(bus, "robot"), Mailbox(1_000_000), Mailbox(1)
            for name, box in (("pose", self._poses), ("map", self._maps)):
                key = messages.topic_key(f"robot/{name}", topic(name).type)
                bus.subscribe(key, box.put, latched=topic(name).latched)
            while not {"matcher", "mapper"} <= self._health.ready():
                assert time.monotonic() < end, f"only {self._health.ready()} are ready"
                time.sleep(0.1)
            self._feed = Feed(run_dir, args.speed) if args.speed != 1 else None
            if self._feed is not None:
                self._feed.start()
            try:
                self._look(run_dir, up, args)
            finally:
                if self._feed is not None:
                    self._feed.stop()

    def _look(self, run_dir, up, args):
        began, known, known_before = time.monotonic(), 0, 0
        row_due = began + args.every
        while (now := time.monotonic()) < began + args.hours * 3600:
            if (grid := self._maps.take(0.0)) is not None:
                cells = messages.decode(bytes(grid.payload), topic("map").type).data
                known = int(np.count_nonzero(np.asarray(cells, dtype=np.int8) >= 0))
            self.samples.append((now - began, processes(up, run_dir, self._health), known))
            self._take_poses()
            if known > (1 + AREA_GROWS) * known_before:
                known_before, self.complete = known, len(self.ways_ms)
            if now >= row_due:
                row_due += args.every
                self._row()
            time.sleep(min(SAMPLE_S, max(0.0, began + args.hours * 3600 - now)))

    def _take_poses(self):
        for one in self._poses.take_all():
            stamp_ns = messages.peek_stamp_ns(bytes(one.payload))
            if self._feed is None:
                began_ns = stamp_ns + REVOLUTION_MS * 1e6
            elif (began_ns := self._feed.sent_ns.pop(stamp_ns, None)) is None:
                continue
            self.ways_ms.append((one.attachment.published_ns - began_ns) / 1e6)

    def _row(self):
        """Print how it stands."""
        seconds, found, _ = self.samples[-1]
        ways, self._rows = self.ways_ms[self._rows :], len(self.ways_ms)
        p50, p99, worst = np.percentile(ways, (50, 99, 100)) if ways else (np.nan,) * 3
        vitals = self._health.vitals()
        late = int(vitals["monitor"].number("late")) if "monitor" in vitals else 0
        load = os.getloadavg()[0]
        way = f"pose p50 {p50:.1f} p99 {p99:.1f} max {worst:.0f} ms"
        print(f"{seconds / 60:6.1f} min  {way}  {len(ways)} poses  {late} scans late  load {load:.1f}")
        for name, (rss, fds, threads, _) in sorted(found.items()):
            values = vitals[name].values if name in vitals else {}
            lost = sum(int(v) for k, v in values.items() if k.endswith((".overwritten", ".missed")))
            print(f"            {name:11} {rss:7.1f} MB  {fds:3} files  {threads:3} threads  {lost:5} lost")
        sys.stdout.flush()


def processes(up, run_dir, health):
    """Return what the kernel says of every process of the run."""
    vitals = health.vitals()
    pids = {name: int(vital.number("pid")) for name, vital in vitals.items()}
    pids["supervisor"] = up
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().decode().split("\0")
        except OSError:
            continue
        if "runtime.supervision.hub" in words and str(run_dir) in words:
            pids["hub"] = int(entry.name)
    found = {}
    for name, pid in pids.items():
        if pid == os.getpid():  # the laser of a simulated drive is this very program
            continue
        try:
            status = Path(f"/proc/{pid}/status").read_text()
            fds = len(os.listdir(f"/proc/{pid}/fd"))
        except OSError:
            continue
        fields = dict(line.split(":", 1) for line in status.splitlines())
        rss_mb, threads = int(fields["VmRSS"].split()[0]) / 1e3, int(fields["Threads"])
        map_mb = vitals[name].number("map_mb") if name in vitals else 0.0
        found[name] = (rss_mb, fds, threads, map_mb)
    return found


def report(watch, metrics, speed, code, stop_s):
    """Print slopes over the second half, p99 at both ends, and what is wrong; return 1 if anything is."""
    faults = [] if code == 130 else [f"exit code {code}"]
    slopes = {}
    half = watch.samples[-1][0] / 2
    for name in sorted({name for _, found, _ in watch.samples for name in found}):
        points = [
            (t * speed / 3600, *found[name]) for t, found, _ in watch.samples if t >= half and name in found
        ]
        if len(points) < 3:
            continue
        hours, rss, fds, threads, map_mb = np.array(points).T
        slopes[name] = round(float(np.polyfit(hours, rss - map_mb, 1)[0]), 2)
        word = verdict(name, hours, slopes[name], (fds, threads))
        faults += [f"{name} {word}"] if word.startswith("GROWS") else []
        print(
            f"{name:11} {rss[0]:7.1f} -> {rss[-1]:7.1f} MB  of maps {map_mb[0]:4.0f} -> {map_mb[-1]:4.0f}  "
            f"rest {slopes[name]:+7.2f} MB/h  "
            f"files {fds[0]:.0f} -> {fds[-1]:.0f}  threads {threads[0]:.0f} -> {threads[-1]:.0f}  {word}"
        )
    first_ms, last_ms, judged = ends(watch.ways_ms[watch.complete :])
    ratio = last_ms / first_ms
    word = "steady" if ratio <= P99_RATIO else "SLOWER"
    print(f"p99 {first_ms:.1f} -> {last_ms:.1f} ms, {ratio:.2f} times: {word if judged else 'too few poses'}")
    faults += [f"p99 {ratio:.2f} times"] if judged and ratio > P99_RATIO else []
    latency = metrics.get("latency", {})
    print(
        json.dumps(
            {
                "bench": "soak",
                "minutes": round(watch.samples[-1][0] / 60, 1),
                "speed": speed,
                "slope_mb_per_h": slopes,
                "p99_ms": [round(first_ms, 1), round(last_ms, 1)],
                "p99_ratio": round(ratio, 2),
                "scans": latency.get("scans"),
                "late": latency.get("late"),
                "faults": faults,
                "exit_code": code,
                "stop_s": round(stop_s, 1),
            }
        )
    )
    return int(bool(faults))


def verdict(name, hours, slope, handles):
    """Return in a word whether a process grows, from what it had over the second half (N,) each."""
    tenth = max(1, len(hours) // 10)
    grew = [float(np.median(one[-tenth:]) - np.median(one[:tenth])) for one in handles]
    if max(grew) > GROWS_HANDLES:
        return "GROWS in files or threads"
    if name in NOT_ON_A_ROBOT:
        return "not on a robot"
    if hours[-1] - hours[0] < DRIVEN_MIN_H:
        return "too short to tell"
    return "steady" if slope <= GROWS_MB_H else "GROWS"


def ends(ways_ms):
    """Return the p99 of the first and of the last tenth, ms, and whether they tell anything."""
    if not ways_ms:
        return np.nan, np.nan, False
    tenth = max(1, len(ways_ms) // 10)
    first, last = (float(np.percentile(part, 99)) for part in (ways_ms[:tenth], ways_ms[-tenth:]))
    return first, last, tenth >= POSES_MIN


if __name__ == "__main__":
    sys.exit(main())
