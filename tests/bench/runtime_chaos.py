"""Processes of the running demo are killed and frozen at random; everything must be back within two seconds.

    python tests/bench/runtime_chaos.py [--blows 200] [--seed 1] [--every 3.0]

Each blow is a SIGKILL or a SIGSTOP to one random process, the hub among them. Back means: a new process of
that name has declared itself ready.
"""

import argparse
import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from runtime import links, messages  # noqa: E402
from runtime.bus import Mailbox  # noqa: E402
from runtime.bus_zenoh import ZenohBus  # noqa: E402
from runtime.health import Health  # noqa: E402
from runtime.topics import topic  # noqa: E402

BACK_S = 2.0
GIVE_UP_S = 30.0


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--blows", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--every", type=float, default=3.0, help="seconds of peace between two blows")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hw") as folder:
        environment = {**os.environ, "HALLWAY_RUN": f"{folder}/run", "PYTHONPATH": str(ROOT)}
        command = [sys.executable, "-m", "runtime.cli", "up", "demo", "--headless", "--out", f"{folder}/res"]
        with subprocess.Popen(command, env=environment, stdout=subprocess.DEVNULL, cwd=ROOT) as up:
            try:
                blows = rage(Path(folder) / "run" / "robot", args)
            finally:
                up.send_signal(signal.SIGINT)
                code = up.wait(120)
        run = json.loads((Path(folder) / "res" / "run.json").read_text())
    report(blows, code, run)


def rage(run_dir, args):
    """Strike; return one row for each blow: name, signal, seconds until it was back."""
    rng = random.Random(args.seed)
    end = time.monotonic() + 90
    while not (run_dir / "hub.sock").exists():
        assert time.monotonic() < end, "the demo did not start"
        time.sleep(0.05)
    names = ("simulator", "monitor", "mapper", "matcher", "base", "operator", "laser")
    blows = []
    with ZenohBus(links.peer(run_dir, "chaos")) as bus:
        health = Health(bus, "robot")
        poses = Mailbox(1)
        bus.subscribe(messages.topic_key("robot/pose", topic("pose").type), poses.put)
        while not set(names) <= health.ready() or not poses.received:
            assert time.monotonic() < end, f"only {health.ready()} are ready"
            time.sleep(0.05)
        while (number := len(blows)) < args.blows:
            name, blow = rng.choice((*names, "hub")), rng.choice((signal.SIGKILL, signal.SIGSTOP))
            old = pid_of(health, run_dir, name)
            try:
                os.kill(old, blow)
            except ProcessLookupError:  # down already, by a blow to another
                time.sleep(0.5)
                continue
            back_s = until_back(health, run_dir, name, old, time.monotonic())
            blows.append((name, blow.name, back_s))
            told = "not back" if back_s is None else f"{back_s:.2f} s"
            print(f"{number + 1:4} {name:10} {blow.name:8} {told}", flush=True)
            if back_s is None:
                break
            quiet_until = time.monotonic() + args.every
            while time.monotonic() < quiet_until:
                time.sleep(0.05)
    return blows


def until_back(health, run_dir, name, old, began):
    """Wait until another process of that name is ready; return how long it took, or None."""
    while time.monotonic() - began < GIVE_UP_S:
        fresh = pid_of(health, run_dir, name)
        ready = (run_dir / "hub.sock").exists() if name == "hub" else name in health.ready()
        if ready and fresh not in (0, old):
            return time.monotonic() - began
        time.sleep(0.01)
    return None


def pid_of(health, run_dir, name):
    """Return the process at work under a name, by its own word; a spare one stands by without a word."""
    if name != "hub":
        vital = health.vitals().get(name)
        return int(vital.number("pid")) if vital else 0
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError):
            words = (entry / "cmdline").read_bytes().decode().split("\0")
            if str(run_dir) in words and "runtime.hub" in words:
                return int(entry.name)
    return 0


def report(blows, code, run):
    """Print what took how long, and what was left of the run."""
    print()
    for name in sorted({name for name, _, _ in blows}):
        times = [GIVE_UP_S if s is None else s for n, _, s in blows if n == name]
        p50, worst = np.percentile(times, (50, 100))
        slow = sum(s > BACK_S for s in times)
        took = f"back p50 {p50:.2f} s  max {worst:.2f} s  {slow} over {BACK_S:g} s"
        print(f"{name:10} {len(times):3} blows  {took}")
    times = [GIVE_UP_S if s is None else s for _, _, s in blows]
    print(
        json.dumps(
            {
                "bench": "runtime_chaos",
                "unit": "s",
                "blows": len(times),
                "over_2_s": sum(s > BACK_S for s in times),
                "p50": round(float(np.median(times)), 2),
                "max": round(max(times), 2),
                "exit_code": code,
                "restarts": sum(p["restarts"] for p in run["processes"].values()),
                "load": [round(value, 1) for value in os.getloadavg()],
            }
        )
    )


if __name__ == "__main__":
    main()
