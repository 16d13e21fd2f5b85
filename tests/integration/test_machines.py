"""One launch file on two machines: both on this one, each with its own folders and keys, joined by TLS.

The clock of the second is an hour ahead.
"""

import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import pytest

from runtime import config, graph, messages
from runtime.access import gate, keys
from runtime.bus import links
from runtime.bus.contract import Mailbox
from runtime.bus.zenoh_bus import ZenohBus
from runtime.nodes.convert import pose_from_message
from runtime.process.health import Health
from runtime.process.status import status_of
from runtime.tiles import Mosaic
from runtime.topics import topic

ROOT = Path(__file__).resolve().parents[2]
AN_HOUR_AHEAD = """
import time
_time_ns = time.time_ns
time.time_ns = lambda: _time_ns() + 3_600_000_000_000
"""


class Site:
    """Two machines, `pi` and `desk`, and one graph: the demo with some of its processes on the desk."""

    def __init__(self, folder, runs, away):
        self.folder = folder
        self._runs = runs
        data = config.load_yaml(graph.find("demo"))
        data["hosts"] = ["pi", "desk"]
        for name in away:
            data["nodes"][name]["host"] = "desk"
        (folder / "g.yaml").write_text(config.to_yaml(data))
        (folder / "later").mkdir()
        (folder / "later" / "sitecustomize.py").write_text(AN_HOUR_AHEAD)
        self.address = free_address()
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("HALLWAY_KEYS", str(folder / "pi-keys"))
            keys.make("robot", ["127.0.0.1"])
            file = folder / "desk.invitation"
            keys.write_private(file, keys.invite("robot", "desk", "machine", self.address).to_bytes())
            patch.setenv("HALLWAY_KEYS", str(folder / "desk-keys"))
            keys.pair(file)

    def run_dir(self, host):
        return self._runs / host / "robot"

    @contextlib.contextmanager
    def up(self, host):
        """Start a machine's part; it is gone with the block."""
        environment = {
            **{key: value for key, value in os.environ.items() if not key.startswith("HALLWAY")},
            "PYTHONPATH": os.pathsep.join([str(ROOT), *[str(self.folder / "later")] * (host == "desk")]),
            "HALLWAY_RUN": str(self._runs / host),
            "HALLWAY_KEYS": str(self.folder / f"{host}-keys"),
        }
        command = [sys.executable, "-m", "runtime.cli", "up", "g.yaml", "--headless", "--host", host]
        command += ["--out", f"{host}-res", *["--remote", self.address] * (host == "pi")]
        with (
            (self.folder / f"{host}.log").open("w") as log,
            subprocess.Popen(command, cwd=self.folder, env=environment, stdout=log, stderr=log) as process,
        ):
            try:
                until((self.run_dir(host) / "hub.sock").exists, 200)
                yield process
            finally:
                process.send_signal(signal.SIGINT)
                try:
                    process.wait(60)
                finally:
                    process.kill()

    def said(self, host):
        return (self.folder / f"{host}.log").read_text()


@pytest.fixture
def runs():
    """A folder for the machines' sockets, whose paths have at most 107 characters."""
    with tempfile.TemporaryDirectory(prefix="runs-") as folder:
        yield Path(folder)


def until(condition, within_s=60.0):
    end = time.monotonic() + within_s
    while not (value := condition()):
        assert time.monotonic() < end, "did not happen in time"
        time.sleep(0.05)
    return value


def lines(health):
    return {line.name: line for line in status_of("robot", health.vitals()).processes}


def number(health, name, key):
    vital = health.vitals().get(name)
    return vital.number(key) if vital is not None else 0.0


@pytest.mark.timeout(300)
def test_a_matcher_and_a_mapper_elsewhere_make_the_map_and_one_that_is_killed_goes_on_with_it(tmp_path, runs):
    site = Site(tmp_path, runs, ("matcher", "mapper"))
    # The desk first: it waits for the robot.
    with site.up("desk") as desk, site.up("pi") as pi, ZenohBus(links.visitor(site.run_dir("pi"))) as bus:
        health = Health(bus, "robot")
        until(lambda: number(health, "mapper", "scans") > 30, 100)
        until(lambda: lines(health)["mapper"].state == "running")
        seen = lines(health)
        assert {name: line.host for name, line in seen.items() if line.host} == dict.fromkeys(
            ("matcher", "mapper", "hub_desk"), "desk"
        )
        assert seen["laser"].state == "running"
        # An hour of another clock would be an hour of latency.
        assert 0 < number(health, "monitor", "latency.whole.p50_ms") < 2000
        # What is asked for tile by tile is answered from there.
        assert bus.ask("hallway/robot/map", Mosaic().question(12_000))
        before, old = number(health, "mapper", "scans"), int(number(health, "mapper", "pid"))
        os.kill(old, signal.SIGKILL)
        until(lambda: int(number(health, "mapper", "pid")) not in (0, old))
        until(lambda: number(health, "mapper", "scans") > before + 20)
        assert number(health, "mapper", "resumptions") == 1
        assert number(health, "matcher", "resumptions") == 0
        until(lambda: lines(health)["mapper"].restarts == 1)
        pi.send_signal(signal.SIGINT)
        assert desk.wait(60) == 0  # the robot has ended, and so has its other half, with the map
    assert "expects mapper, matcher from desk" in site.said("pi")
    assert "expects simulator, monitor, base, operator, laser, pretrigger from pi" in site.said("desk")
    assert "the robot has ended" in site.said("desk")
    written = {path.name for path in (tmp_path / "desk-res").iterdir()}
    assert {"map.pgm", "map.yaml", "trajectory.tum", "session.mcap"} <= written
    assert not (tmp_path / "pi-res" / "map.pgm").exists()
    poses = np.loadtxt(tmp_path / "desk-res" / "trajectory.tum")
    assert np.all(np.diff(poses[:, 0]) > 0)


@pytest.mark.timeout(300)
def test_the_other_machine_begins_anew_with_a_robot_that_had_no_last_word(tmp_path, runs):
    site = Site(tmp_path, runs, ("mapper",))

    def mapper_at_work(bus, but=0):
        health = Health(bus, "robot")

        def pid():
            return int(number(health, "mapper", "pid"))

        until(lambda: pid() not in (0, but) and number(health, "mapper", "scans") > 20, 100)
        assert number(health, "mapper", "resumptions") == 0
        return pid()

    with site.up("desk") as desk:
        with site.up("pi") as pi, ZenohBus(links.visitor(site.run_dir("pi"))) as bus:
            first = mapper_at_work(bus)
            pi.kill()
            pi.wait(10)
        with site.up("pi") as pi, ZenohBus(links.visitor(site.run_dir("pi"))) as bus:
            mapper_at_work(bus, but=first)
            pi.send_signal(signal.SIGINT)
            assert desk.wait(60) == 0
    said = site.said("desk")
    assert said.count("expects ") == 2
    assert said.index("the robot has begun a new run") < said.index("the robot has ended")
    # Of each run its own map.
    for folder in ("desk-res.old", "desk-res"):
        assert (tmp_path / folder / "map.pgm").exists()


@pytest.mark.timeout(300)
def test_the_wheels_stop_when_the_machine_that_drives_and_matches_is_gone(tmp_path, runs):
    site = Site(tmp_path, runs, ("matcher", "operator"))
    with site.up("pi"), ZenohBus(links.visitor(site.run_dir("pi"))) as bus:
        health, truths = Health(bus, "robot"), Mailbox(10_000)
        bus.subscribe(key_of("truth"), truths.put)
        until(lambda: "matcher" in lines(health))
        assert (lines(health)["matcher"].text, lines(health)["matcher"].host) == ("not heard yet", "desk")
        with site.up("desk") as desk:
            until(lambda: number(health, "mapper", "scans") > 20, 100)
            until(lambda: "driving" in health.vitals()["operator"].text)
            truths.take_all()
            time.sleep(1.0)
            assert way_m(truths.take_all()) > 0.02
            desk.kill()  # and with it, by the kernel, all that it had started
            time.sleep(0.25 + 0.25)  # law 5, and the line to the wheels
            truths.take_all()
            time.sleep(1.0)
            assert way_m(truths.take_all()) < 0.002
            until(lambda: lines(health)["matcher"].level == "stale")
        assert health.vitals()["base"].values["state"] == "disarmed"
        assert lines(health)["mapper"].level in ("ok", "warn")  # its own process, here, waits


def test_another_machine_says_what_its_processes_say_and_nothing_that_devices_say(tmp_path, monkeypatch):
    monkeypatch.setenv("HALLWAY_KEYS", str(tmp_path / "keys"))
    owner = keys.make("robot", ["127.0.0.1"])
    address = free_address()
    invitation = keys.invite("robot", "desk", "machine", address)
    door = gate.door(owner, "robot", 0, address, owner.roster())
    pi, desk = tmp_path / "pi", tmp_path / "desk"
    pi.mkdir()
    desk.mkdir()
    with (
        ZenohBus(links.hub(desk, gate.lead(invitation))),  # before the robot, that it waits for
        ZenohBus(links.hub(pi, door)),
        ZenohBus(links.peer(pi, "monitor")) as here,
        ZenohBus(links.peer(desk, "mapper")) as there,
    ):
        heard = {name: Mailbox(100) for name in ("odom", "cmd_vel", "scan", "battery")}
        for name, box in heard.items():
            here.subscribe(key_of(name), box.put)
        tongues = [there.publisher(key_of(name)) for name in heard]

        def spoken():
            for tongue in tongues:
                tongue.put(bytes(100), b"")
            return min(heard["odom"].received, heard["cmd_vel"].received) > 20

        until(spoken)
        assert (heard["scan"].received, heard["battery"].received) == (0, 0)
        there.answer("hallway/robot/clock", lambda asked: bytes(8))
        there.answer("hallway/robot/map", lambda asked: b"tiles")
        until(lambda: here.ask("hallway/robot/map") == [b"tiles"])
        assert here.ask("hallway/robot/clock", timeout_s=0.3) == []


def key_of(name):
    return messages.topic_key(f"robot/{name}", topic(name).type)


def free_address():
    with contextlib.closing(socket.socket()) as free:
        free.bind(("127.0.0.1", 0))
        return f"127.0.0.1:{free.getsockname()[1]}"


def way_m(truths):
    places = [
        pose_from_message(messages.decode(bytes(one.payload), topic("truth").type).pose)[:2] for one in truths
    ]
    assert len(places) > 5
    return float(np.hypot(*np.diff(places, axis=0).T).sum())
