"""The demo for hours: does anything grow, slow down, or get lost?

    python tests/bench/soak.py [--hours 1] [--every 300] [--with recorder viewer]

Every `--every` seconds one row for each process: resident memory, file descriptors, threads, and what it
lost; and the way of a scan (first ray to pose, beyond the sensor's revolution) in that time. At the end the
slope of each process's memory over the second half of the run. A process is said to grow from 4 MB an hour
on; the mapper keeps what it must: a pose for every scan.
"""

import argparse
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

from runtime import config, graph, links, messages  # noqa: E402
from runtime.bus import Mailbox  # noqa: E402
from runtime.bus_zenoh import ZenohBus  # noqa: E402
from runtime.health import Health  # noqa: E402
from runtime.topics import topic  # noqa: E402

REVOLUTION_MS = 100.0
GROWS_MB_H = 4.0
SAMPLE_S = 10.0
EXTRA = {
    "recorder": {"module": "recorder", "required": False, "config": {"recording": {"ring_s": 120}}},
    "viewer": {"module": "viewer", "required": False, "nice": 10, "config": {"mode": "web"}},
}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--hours", type=float, default=1.0)
    parser.add_argument("--every", type=float, default=300.0, metavar="S")
    parser.add_argument("--with", dest="extra", nargs="*", default=["recorder"], choices=list(EXTRA))
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hw", dir=MEMORY) as folder:
        data = config.load_yaml(graph.find("demo"))
        del data["nodes"]["viewer"]
        data["nodes"] |= {name: EXTRA[name] for name in args.extra}
        file = Path(folder) / "soak.yaml"
        file.write_text(config.to_yaml(data))
        environment = {**os.environ, "HALLWAY_RUN": f"{folder}/run", "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-m", "runtime.cli", "up", str(file), "--out", f"{folder}/res"]
        if "viewer" not in args.extra:
            command.append("--headless")
        with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, cwd=ROOT) as up:
            try:
                samples = watch(Path(folder) / "run" / "robot", up, args)
            finally:
                began = time.monotonic()
                up.send_signal(signal.SIGINT)
                code = up.wait(300)
                stop_s = time.monotonic() - began
        metrics = json.loads((Path(folder) / "res" / "metrics.json").read_text())
    report(samples, metrics, code, stop_s)


def watch(run_dir, up, args):
    """Sample until the time is over; return (seconds, {process: (rss_mb, fds, threads)}) each."""
    end = time.monotonic() + 90
    while not (run_dir / "hub.sock").exists():
        assert time.monotonic() < end, "the demo did not start"
        time.sleep(0.1)
    samples = []
    with ZenohBus(links.peer(run_dir, "soak")) as bus:
        health = Health(bus, "robot")
        poses = Mailbox(1_000_000)
        bus.subscribe(messages.topic_key("robot/pose", topic("pose").type), poses.put)
        began = time.monotonic()
        row_due = began + args.every
        while (now := time.monotonic()) < began + args.hours * 3600:
            samples.append((now - began, processes(up.pid, run_dir, health)))
            if now >= row_due:
                row_due += args.every
                row(samples, health, poses)
            time.sleep(SAMPLE_S)
    return samples


def processes(up, run_dir, health):
    """Return what the kernel says of every process of the run."""
    pids = {name: int(vital.number("pid")) for name, vital in health.vitals().items()}
    pids["supervisor"] = up
    for entry in Path("/proc").glob("[0-9]*"):
        try:
            words = (entry / "cmdline").read_bytes().decode().split("\0")
        except OSError:
            continue
        if "runtime.hub" in words and str(run_dir) in words:
            pids["hub"] = int(entry.name)
    found = {}
    for name, pid in pids.items():
        try:
            status = Path(f"/proc/{pid}/status").read_text()
            fds = len(os.listdir(f"/proc/{pid}/fd"))
        except OSError:
            continue
        fields = dict(line.split(":", 1) for line in status.splitlines())
        found[name] = (int(fields["VmRSS"].split()[0]) / 1e3, fds, int(fields["Threads"]))
    return found


def row(samples, health, poses):
    """Print how it stands."""
    seconds, found = samples[-1]
    ways = [
        (one.attachment.published_ns - messages.peek_stamp_ns(bytes(one.payload))) / 1e6 - REVOLUTION_MS
        for one in poses.take_all()
    ]
    p50, p99, worst = np.percentile(ways, (50, 99, 100)) if ways else (np.nan,) * 3
    vitals = health.vitals()
    late = int(vitals["monitor"].number("late")) if "monitor" in vitals else 0
    load = os.getloadavg()[0]
    way = f"pose p50 {p50:.1f} p99 {p99:.1f} max {worst:.0f} ms"
    print(f"{seconds / 60:6.0f} min  {way}  {len(ways)} poses  {late} scans late  load {load:.1f}")
    for name, (rss, fds, threads) in sorted(found.items()):
        values = vitals[name].values if name in vitals else {}
        lost = sum(int(v) for k, v in values.items() if k.endswith((".overwritten", ".missed")))
        print(f"            {name:11} {rss:7.1f} MB  {fds:3} files  {threads:3} threads  {lost:5} lost")
    sys.stdout.flush()


def report(samples, metrics, code, stop_s):
    """Print the slopes over the second half, and what they mean."""
    half = samples[-1][0] / 2
    verdicts = {}
    for name in sorted({name for _, found in samples for name in found}):
        points = [(t / 3600, *found[name]) for t, found in samples if t >= half and name in found]
        if len(points) < 3:
            continue
        hours, rss, fds, threads = np.array(points).T
        slope = float(np.polyfit(hours, rss, 1)[0])
        tenth = max(1, len(points) // 10)
        grew = [np.median(one[-tenth:]) - np.median(one[:tenth]) for one in (fds, threads)]
        word = "GROWS" if slope > GROWS_MB_H or max(grew) > 2 else "steady"
        verdicts[name] = round(slope, 2)
        print(
            f"{name:11} {rss[0]:7.1f} -> {rss[-1]:7.1f} MB  {slope:+7.2f} MB/h  "
            f"files {fds[0]:.0f} -> {fds[-1]:.0f}  threads {threads[0]:.0f} -> {threads[-1]:.0f}  {word}"
        )
    latency = metrics.get("latency", {})
    print(
        json.dumps(
            {
                "bench": "soak",
                "minutes": round(samples[-1][0] / 60, 1),
                "slope_mb_per_h": verdicts,
                "scans": latency.get("scans"),
                "late": latency.get("late"),
                "exit_code": code,
                "stop_s": round(stop_s, 1),
            }
        )
    )


if __name__ == "__main__":
    main()
