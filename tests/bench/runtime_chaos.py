"""Processes of the running demo are killed and frozen at random; what must come back, stand still, and stay.

    python tests/bench/runtime_chaos.py [--blows 200] [--seed 1] [--every 3.0] [--fifo]

Each blow is a SIGKILL or a SIGSTOP to one random process, the hub among them. For each:

* how long until a new process of that name has declared itself ready; 2 s are allowed;
* after a blow to the base or the operator, how long the wheels went on turning until they stood. Decided is
  it after 0.25 s at most; a turn of the base's loop and of its line may come on top. The hub only introduces
  processes to each other: the operator goes on driving without it. Whomever the blow met, the robot is never
  seen to move without a command as young as that;
* how much of the map that was known before is missing in the map after a blow to the mapper;
* how much farther, or less far, a pose lies from the one before it than what the robot drove meanwhile.

Where the robot is, how it moves, is the simulator's word (`truth`, ten times a second). `--fifo` gives base,
laser and matcher the priorities that `launch/onboard.yaml` gives them, and the simulator, which is the robot
here, one above them: wheels do not wait for a processor.
"""

import argparse
import contextlib
import json
import os
import random
import signal
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from robot_run import started

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

from runtime import config, graph, messages  # noqa: E402
from runtime.bus import links  # noqa: E402
from runtime.bus.contract import Mailbox  # noqa: E402
from runtime.bus.offset import measured  # noqa: E402
from runtime.bus.zenoh_bus import ZenohBus  # noqa: E402
from runtime.clock import Clock  # noqa: E402
from runtime.nodes.convert import pose_from_message  # noqa: E402
from runtime.process.health import Health  # noqa: E402
from runtime.topics import topic  # noqa: E402

MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""As a run's directory is on a robot with systemd: a checkpoint waits for no disk that others use."""
BACK_S = 2.0
STILL_S = 0.25
TURN_S = 0.04
"""Until what the base decided is with the wheels: its loop turns every 0.02 s, its robot every 0.015 s."""
KNOWN_SHARE = 0.99
"""Of the cells that were known: what was seen since the last checkpoint may be missing."""
LEAP_M = 0.2
"""Match and map are right to some centimetres; the next wall that looks the same is farther."""
GIVE_UP_S = 30.0
TRUTH_S = 0.1
RIM_M = 0.13
"""Half the wheel base: what a wheel runs for each radian the robot turns."""
MOVES_MPS = 0.01
STOPS_WHEELS = ("base", "operator")


@dataclass
class Blow:
    """What one blow did; None where it does not apply."""

    name: str
    signal: str
    back_s: float | None
    still_s: float | None = None
    unbidden_s: float = 0.0
    known_share: float | None = None
    leap_m: float = 0.0

    def faults(self):
        """Return what is not as it must be."""
        if self.back_s is None:
            return ["not back"]
        return [
            *(["late"] if self.back_s > BACK_S else []),
            *(["rolled on"] if (self.still_s or 0.0) > STILL_S + TURN_S else []),
            *(["moved unbidden"] if self.unbidden_s else []),
            *(["map lost"] if self.known_share is not None and self.known_share < KNOWN_SHARE else []),
            *([f"leap of {self.leap_m:.2f} m"] if self.leap_m > LEAP_M else []),
        ]


class Watch:
    """What the robot said, in the order of its stamps; times are ns of the robot's clock."""

    def __init__(self, bus):
        self._boxes = {}
        for name in ("truth", "pose", "cmd_vel", "map", "map_updates"):
            row = topic(name)
            self._boxes[name] = Mailbox(10_000)
            key = messages.topic_key(f"robot/{name}", row.type)
            bus.subscribe(key, self._boxes[name].put, latched=row.latched)
        self._truth, self._poses = {}, {}
        self.commanded_ns = []
        self._cells = None
        self.known = 0
        """Cells of the published map that are not unknown."""
        self.maps = 0
        """Whole maps that were published so far."""

    def listen(self):
        """Take in what came."""
        for name, kept in (("truth", self._truth), ("pose", self._poses)):
            for message in self._decoded(name):
                pose = message.pose if name == "truth" else message.pose.pose
                kept[messages.stamp_ns_of(message.header.stamp)] = pose_from_message(pose)
        self.commanded_ns += [one.attachment.published_ns for one in self._boxes["cmd_vel"].take_all()]
        for grid in self._decoded("map"):
            self._cells = np.array(grid.data, dtype=np.int8).reshape(grid.info.height, grid.info.width)
            self.maps += 1
        for part in self._decoded("map_updates"):
            if self._cells is not None:
                changed = np.asarray(part.data, dtype=np.int8).reshape(part.height, part.width)
                self._cells[part.y : part.y + part.height, part.x : part.x + part.width] = changed
        self.known = 0 if self._cells is None else int(np.count_nonzero(self._cells >= 0))

    def truth(self):
        """Return stamps (N,), ns, and where the robot was (N, 3), angle unwrapped."""
        stamps = np.array(sorted(self._truth), dtype=np.int64)
        places = np.array([self._truth[stamp] for stamp in stamps.tolist()])
        places[:, 2] = np.unwrap(places[:, 2])
        return stamps, places

    def poses(self):
        """Return stamps (N,), ns, and the published poses (N, 3)."""
        stamps = np.array(sorted(self._poses), dtype=np.int64)
        return stamps, np.array([self._poses[stamp] for stamp in stamps.tolist()])

    def _decoded(self, name):
        return [messages.decode(bytes(one.payload), topic(name).type) for one in self._boxes[name].take_all()]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--blows", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--every", type=float, default=3.0, help="seconds of peace between two blows")
    parser.add_argument("--fifo", action="store_true", help="with the real-time scheduler, as on a robot")
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hw", dir=MEMORY) as folder:
        file = prepared(args.fifo, Path(folder))
        with started(file, folder, "--headless") as up:
            try:
                blows = rage(Path(folder) / "run" / "robot", args)
            finally:
                up.send_signal(signal.SIGINT)
                code = up.wait(120)
        run = json.loads((Path(folder) / "res" / "run.json").read_text())
    return report(blows, code, run)


def prepared(fifo, folder):
    """Return the demo's graph, with the priorities of a robot if asked."""
    file = graph.find("demo")
    if not fifo:
        return file
    data, onboard = config.load_yaml(file), config.load_yaml(graph.find("onboard"))
    for name in ("base", "laser", "matcher"):
        data["nodes"][name]["priority"] = onboard["nodes"][name]["priority"]
    data["nodes"]["simulator"]["priority"] = 30
    (folder / "fifo.yaml").write_text(config.to_yaml(data))
    return folder / "fifo.yaml"


def rage(run_dir, args):
    """Strike; return a `Blow` for each."""
    rng = random.Random(args.seed)
    end = time.monotonic() + 90
    while not (run_dir / "hub.sock").exists():
        assert time.monotonic() < end, "the demo did not start"
        time.sleep(0.05)
    names = ("simulator", "monitor", "mapper", "matcher", "base", "operator", "laser")
    blows = []
    with ZenohBus(links.peer(run_dir, "chaos")) as bus:
        health, watch, clock = Health(bus, "robot"), Watch(bus), Clock()
        while not set(names) <= health.ready() or not watch.known:
            assert time.monotonic() < end, f"only {health.ready()} are ready"
            watch.listen()
            time.sleep(0.05)
        clock.offset_ns += measured(bus, "robot", clock).offset_ns
        peace(watch, args.every)
        while len(blows) < args.blows:
            name, blow = rng.choice((*names, "hub")), rng.choice((signal.SIGKILL, signal.SIGSTOP))
            old = pid_of(health, run_dir, name)
            watch.listen()
            known, maps, struck_ns = watch.known, watch.maps, clock.now_ns()
            try:
                os.kill(old, blow)
            except ProcessLookupError:  # down already, by a blow to another
                time.sleep(0.5)
                continue
            one = Blow(name, blow.name, until_back(health, run_dir, name, old, watch))
            blows.append(one)
            back_ns = clock.now_ns()
            peace(watch, args.every)
            if name == "mapper" and watch.maps > maps:
                one.known_share = watch.known / known
            judge(one, watch, struck_ns, back_ns)
            told = "not back" if one.back_s is None else f"{one.back_s:.2f} s"
            print(f"{len(blows):4} {name:10} {blow.name:8} {told:8} {', '.join(one.faults())}", flush=True)
            if one.back_s is None:
                break
    return blows


def peace(watch, seconds):
    """Let the robot drive, and listen."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        watch.listen()
        time.sleep(0.05)


def judge(blow, watch, struck_ns, back_ns):
    """Fill in what the robot's motion and its poses tell of a blow."""
    stamps, places = watch.truth()
    # What the rim of a wheel ran between two truths; a tenth of a second each, longer where nobody told.
    ran_m = np.hypot(*np.diff(places[:, :2], axis=0).T) + RIM_M * np.abs(np.diff(places[:, 2]))
    seconds = np.diff(stamps) / 1e9
    moves = ran_m > MOVES_MPS * seconds
    if blow.name in STOPS_WHEELS and back_ns - struck_ns > 2 * TRUTH_S * 1e9:
        blow.still_s = still_after(stamps, ran_m, moves, struck_ns, back_ns)
    commanded = np.array(watch.commanded_ns)
    for begin_ns, end_ns, moved in zip(stamps[:-1], stamps[1:], moves, strict=True):
        if begin_ns >= struck_ns and moved and blow.name != "simulator":
            bidden = (commanded > begin_ns - (STILL_S + TURN_S) * 1e9) & (commanded <= end_ns)
            blow.unbidden_s += 0.0 if bidden.any() else (end_ns - begin_ns) / 1e9
    blow.leap_m = leap(watch, struck_ns)


def still_after(stamps, ran_m, moves, struck_ns, back_ns):
    """Return how long after a blow the wheels still turned, s; None if they stood at the time."""
    during = np.flatnonzero((stamps[1:] > struck_ns) & (stamps[1:] <= back_ns))
    if not len(during) or not moves[during[0]]:
        return None
    last = during[moves[during]][-1]
    # They stopped within the last piece: as far into it as its way goes at the speed of those before it.
    paces = ran_m[last - 2 : last + 1] / np.diff(stamps)[last - 2 : last + 1]
    part_ns = float(ran_m[last] / paces.max())
    return float(max(0.0, stamps[last] + part_ns - struck_ns) / 1e9)


def leap(watch, struck_ns):
    """Return the greatest difference of the way between two poses in a row and that of the robot, m."""
    stamps, poses = watch.poses()
    truth_ns, places = watch.truth()
    # The pose before the blow, all that came since, and none that no truth is known for.
    first = max(0, int(np.searchsorted(stamps, struck_ns)) - 1)
    chosen = np.arange(first, len(stamps))
    chosen = chosen[(stamps[chosen] >= truth_ns[0]) & (stamps[chosen] <= truth_ns[-1])]
    if len(chosen) < 2:
        return 0.0
    really = np.stack(
        [np.interp(stamps[chosen] - truth_ns[0], truth_ns - truth_ns[0], places[:, i]) for i in (0, 1)]
    )
    told = poses[chosen, :2].T
    ways = [np.hypot(*np.diff(way, axis=1)) for way in (told, really)]
    return float(np.abs(ways[0] - ways[1]).max())


def until_back(health, run_dir, name, old, watch):
    """Wait until another process of that name is ready; return how long it took, or None."""
    began = time.monotonic()
    while time.monotonic() - began < GIVE_UP_S:
        watch.listen()
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
            if str(run_dir) in words and "runtime.supervision.hub" in words:
                return int(entry.name)
    return 0


def report(blows, code, run):
    """Print what took how long, what was lost, and what was left of the run; return 1 for any fault."""
    print()
    for name in sorted({one.name for one in blows}):
        those = [one for one in blows if one.name == name]
        p50, worst = np.percentile([back_of(one) for one in those], (50, 100))
        line = f"{name:10} {len(those):3} blows  back p50 {p50:.2f} s  max {worst:.2f} s"
        still = [one.still_s for one in those if one.still_s is not None]
        shares = [one.known_share for one in those if one.known_share is not None]
        line += f"  wheels stood after {max(still):.2f} s at most ({len(still)} times)" if still else ""
        line += f"  map at least {100 * min(shares):.1f} %" if shares else ""
        print(f"{line}  pose off by {max(one.leap_m for one in those):.3f} m at most")
    faults = [f"{number} {one.name}: {', '.join(one.faults())}" for number, one in enumerate(blows, 1)
              if one.faults()]  # fmt: skip
    times = [back_of(one) for one in blows]
    print(
        json.dumps(
            {
                "bench": "runtime_chaos",
                "unit": "s",
                "blows": len(blows),
                "over_2_s": sum(s > BACK_S for s in times),
                "p50": round(float(np.median(times)), 2),
                "max": round(max(times), 2),
                "still_max": round(max((one.still_s or 0.0 for one in blows), default=0.0), 3),
                "unbidden": round(sum(one.unbidden_s for one in blows), 2),
                "known_share_min": min((one.known_share for one in blows if one.known_share), default=None),
                "leap_max_m": round(max(one.leap_m for one in blows), 3),
                "faults": faults,
                "exit_code": code,
                "restarts": sum(p["restarts"] for p in run["processes"].values()),
                "load": [round(value, 1) for value in os.getloadavg()],
            }
        )
    )
    return int(bool(faults) or code != 130)


def back_of(blow):
    """Return how long it took; as long as anybody waited if it never came."""
    return GIVE_UP_S if blow.back_s is None else blow.back_s


if __name__ == "__main__":
    sys.exit(main())
