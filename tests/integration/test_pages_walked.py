"""A newcomer walks through the pages and types what they show, in their order, on a machine without a robot.

Every call on a page is in one of the two tables here; one that is added to a page has to be added here.
"""

import bz2
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from runtime.bus import links
from runtime.bus.zenoh_bus import ZenohBus
from runtime.cli.study import drives
from runtime.process.health import Health
from tests.integration.test_docs import calls

ROOT = Path(__file__).resolve().parents[2]
SCANS = 120
# What the page's command does is held down where there is room for it.
ELSEWHERE = {
    "--version": "test_docs",
    "completion bash": "test_docs",
    "doctor --udev": "test_docs",
    "up demo": "test_demo",
    "up onboard": "as mine.yaml, which is its copy",
    "view": "test_view_command, in a browser",
    "view walk.mcap": "test_view_command, on a page",
    "view walk.mcap --web": "test_view_command, in a browser",
    "view walk.rrd": "test_view_command, in a browser",
    "view --save live.rrd": "test_view_command, until the robot ends",
    "replay walk.mcap --as film --paused": "test_replay, key by key",
    "teleop": "test_teleop, on a terminal",
    "paper --out paper": "test_paper_command",
    "paper --buildings doorway --scans 120": "test_paper_command, with fewer scans",
    "paper --buildings floor loop": "test_paper_command, in a doorway",
    "paper --logs exp1.dat exp2.dat ccny_urg.bag": "test_paper_command, with a log of its own",
}


@dataclass(frozen=True, slots=True)
class Call:
    """What a page shows, what is to come out of it, and what is added so that it ends by itself."""

    words: str
    code: int | tuple[int, ...]
    says: str
    more: tuple[str, ...] = ()
    first: Callable[[Path], None] = lambda desk: None
    """What a person does before it, with other programs."""


def carry_logs(desk):
    """The scans of a session are a log: the same drive on three days."""
    for day in ("day1", "day2", "day3"):
        shutil.copy(desk / "results" / "intel" / "session.mcap", desk / f"{day}.mcap")


def be_systemd(desk):
    """Nobody's machine is to start a robot because of a test."""
    (desk / "units").mkdir()
    (desk / "bin").mkdir()
    (desk / "bin" / "systemctl").symlink_to("/bin/true")


def split(desk):
    """Somebody names two machines, and which processes the second has."""
    text = (desk / "mine.yaml").read_text().replace("nodes:\n", "hosts: [pi, desk]\nnodes:\n")
    for name in ("mapper", "matcher"):
        text = text.replace(f"module: {name},", f"module: {name}, host: desk,")
    (desk / "split.yaml").write_text(text)


def paint(desk):
    """Somebody paints a wall, and a mask beside it."""
    picture = np.asarray(Image.open(desk / "results" / "day1" / "map.pgm")).copy()
    picture[2:6, 2:12] = 0
    Image.fromarray(picture).save(desk / "edited.png")
    mask = np.full_like(picture, 255)
    mask[10:14, 10:14] = 0
    Image.fromarray(mask).save(desk / "keepout.pgm")


def cut(desk):
    """A recorder is killed in the midst of its work."""
    whole = (desk / "walk.mcap").read_bytes()
    (desk / "cut.mcap.active").write_bytes(whole[: len(whole) * 2 // 3])


BEFORE = (
    Call("config check mine.yaml", 0, "7 processes, good"),
    Call("doctor", 3, "plug"),
    Call("up mine.yaml", 3, "No robot? `hallway up handheld`", ("--headless",)),
    Call("up handheld", 3, "no URG", ("--headless",)),
    Call("up mine.yaml --service --enable", 0, "runs, and will", ("--service", "units"), first=be_systemd),
    Call("keys make", 0, ""),
    Call("keys invite laptop --role operator", 0, "laptop.invitation"),
    Call("up onboard --remote", 3, "no such port", ("--headless",)),
    Call("keys pair laptop.invitation", 0, ""),
    Call("keys ros laptop.invitation", 0, "ZENOH_ROUTER_CONFIG_URI"),
    Call("keys invite desk --role machine", 0, "desk.invitation"),
    Call("up split.yaml --host pi", 3, "expects mapper, matcher from desk", ("--headless",), first=split),
    Call("keys pair desk.invitation", 0, "as machine"),
    Call(
        "up split.yaml --host desk",
        0,
        "expects monitor, laser, base, recorder, pretrigger from pi",
        ("--headless", "--duration", "1"),
    ),
    Call(
        "view --connect 192.168.7.20", 1, "cannot be reached", ("--connect", "127.0.0.1", "--save", "far.rrd")
    ),
    Call("map intel.clf.bz2 --out results/intel", 0, "TRACKING"),
    Call("evaluate results/intel/trajectory.tum --relations intel.relations", 0, "m"),
    Call("map day1.mcap --out results/day1", 0, "TRACKING", first=carry_logs),
    # 5: a drive of a few metres need not be enough to be found by; `test_sessions` has one that is.
    Call("map day2.mcap --continue results/day1 --out results/day2", (0, 5), "saved map"),
    Call("info results/day2/session.mcap", 0, "scans"),
    Call("localize results/day1 day3.mcap --out results/where", (0, 5), "saved map"),
    Call("up onboard --on results/day1", 3, "no such port", ("--headless",)),
    Call("layer results/day1 edited.png", 0, "wall", first=paint),
    Call("layer results/day1 --clear wall", 0, ""),
    Call("layer results/day1 --keepout keepout.pgm", 0, "out"),
    Call("layer results/day1 --clear all", 0, ""),
)
BUSY = (0, 4)
"""On a busy machine a message is lost now and then; 4 says so, of the recording and all that read it."""
DURING = (
    # 1 says that something is to be seen to: on a busy machine poses are late.
    Call("status --once", (0, 1), "TRACKING"),
    Call("logs", 0, "mapper"),
    Call("topic list", 0, "robot/scan"),
    Call("topic hz scan", 0, "5 messages", ("-n", "5")),
    Call("topic delay pose", 0, "5 messages", ("-n", "5")),
    Call("topic echo battery", 0, "percentage: ", ("-n", "1")),
    Call("record", BUSY, "messages in recordings/robot-", ("--duration", "1")),
    Call("record --out walk.mcap --duration 20", BUSY, "messages in walk.mcap", ("--duration", "6")),
    Call(
        "record --out parts.mcap --topics scan pose --split-s 5 --duration 12",
        BUSY,
        "parts_000.mcap, parts_001.mcap, parts_002.mcap",
        ("--split-s", "1", "--duration", "2.5"),
    ),
    Call("record --keep --out crash", 0, "crash/: ring_0"),
)
AFTER = (
    Call("map results/latest/recording.mcap --out results/again", 0, "report.html"),
    Call("info walk.mcap", BUSY, "/robot/scan"),
    Call("view walk.mcap --save walk.rrd", 0, "saved to walk.rrd"),
    Call("map walk.mcap --out results/offline", BUSY, "report.html"),
    Call("replay walk.mcap --map", BUSY, "scans mapped"),
    Call("replay walk.mcap", BUSY, "as robot 'robot'", ("--rate", "0")),
    Call("replay walk.mcap --as film --rate 5", BUSY, "as robot 'film'"),
    Call("replay parts_000.mcap parts_001.mcap parts_002.mcap --as film", BUSY, " scan", ("--rate", "0")),
    Call("convert walk.mcap walk-ros2", BUSY, "cannot hold the publishers' sequence numbers"),
    Call("convert walk.mcap walk.bag", BUSY, "only laser scans"),
    Call("convert walk.mcap walk.clf", BUSY, "time_increment"),
    Call("convert walk.mcap walk.dat", BUSY, "scans"),
    Call("convert walk.mcap walk.tum", BUSY, "poses"),
    Call("convert walk.mcap poses.tum --topic /robot/pose", BUSY, "poses"),
    Call("convert cut.mcap.active cut.mcap", 4, "the file was cut", first=cut),
)


@pytest.fixture
def desk(tmp_path):
    """A folder with what the pages suppose to be there: a copied graph, a log with its relations."""
    shutil.copy(ROOT / "launch" / "onboard.yaml", tmp_path / "mine.yaml")
    driven = drives.drive("doorway", SCANS, 1)
    stamps = [f"{1e9 + number / 10:.6f}" for number in range(SCANS)]
    lines = []
    for stamp, scan in zip(stamps, driven.scans, strict=True):
        # Half a turn of them, a degree apart, as that log has it.
        at = np.round(
            (np.radians(np.arange(-90, 90)) - scan.beams.angle_min_rad) / scan.beams.angle_increment_rad
        )
        ranges = np.nan_to_num(scan.ranges_m[at.astype(int)], nan=81.9, posinf=81.9)
        text = " ".join(f"{r:.3f}" for r in ranges)
        lines.append(f"FLASER 180 {text} 0 0 0 0 0 0 {stamp} h {stamp}\n")
    (tmp_path / "intel.clf.bz2").write_bytes(bz2.compress("".join(lines).encode()))
    x, y, yaw = driven.truth[-1]
    (tmp_path / "intel.relations").write_text(f"{stamps[0]} {stamps[-1]} {x} {y} 0 0 0 {yaw}\n")
    return tmp_path


@pytest.fixture
def shell(desk):
    own = {key: value for key, value in os.environ.items() if not key.startswith("HALLWAY")}
    home = {
        "HOME": str(desk / "home"),
        "XDG_CONFIG_HOME": str(desk / "home"),
        "HALLWAY_RUN": str(desk / "run"),
        "PATH": f"{desk / 'bin'}{os.pathsep}{os.environ['PATH']}",
        "SUDO_USER": "nobody",
    }
    environment = {**own, **home, "PYTHONPATH": str(ROOT), "PYTHONWARNINGS": "error"}

    def start(*words):
        command = [sys.executable, "-m", "runtime.cli", *words]
        pipe = subprocess.PIPE
        return subprocess.Popen(
            command,
            cwd=desk,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=pipe,
            stderr=subprocess.STDOUT,
            text=True,
        )

    return start


def type_in(desk, shell, call):
    call.first(desk)
    with shell(*call.words.split(), *call.more) as process:
        said = process.communicate(timeout=150)[0]
    codes = call.code if isinstance(call.code, tuple) else (call.code,)
    assert process.returncode in codes, f"hallway {call.words}: {said}"
    assert call.says in said, f"hallway {call.words}: {said}"


def test_every_call_of_the_pages_is_typed_somewhere():
    typed = {call.words for call in (*BEFORE, *DURING, *AFTER)}
    assert {" ".join(words) for _, words in calls()} == typed | set(ELSEWHERE)


@pytest.mark.timeout(900)
def test_the_pages_can_be_walked_through(desk, shell):
    for call in BEFORE:
        type_in(desk, shell, call)
    graph = (ROOT / "launch" / "demo.yaml").read_text() + "  recorder: {module: recorder, required: false}\n"
    (desk / "recorded.yaml").write_text(graph)
    with shell("up", "recorded.yaml", "--headless") as up:
        try:
            wait_for_track(desk / "run" / "robot", up)
            for call in DURING:
                type_in(desk, shell, call)
        finally:
            up.send_signal(2)
            said = up.communicate(timeout=60)[0]
    assert up.returncode == 130, said
    for call in AFTER:
        type_in(desk, shell, call)


def wait_for_track(run_dir, up, within_s=150.0):
    end = time.monotonic() + within_s
    while not (run_dir / "hub.sock").exists():
        assert time.monotonic() < end
        assert up.poll() is None
        time.sleep(0.05)
    with ZenohBus(links.peer(run_dir, "test")) as bus:
        health = Health(bus, "robot")
        while not (matcher := health.vitals().get("matcher")) or matcher.values.get("state") != "TRACKING":
            assert time.monotonic() < end
            time.sleep(0.05)
