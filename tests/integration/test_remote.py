"""Guests over a network: what each may see and do, proven with the guest in another network namespace.

The two namespaces are joined by one wire and see nothing else. `CI_REQUIRE_NETNS=1` makes it a failure, not
a skip, when this machine does not let us make them.
"""

import base64
import json
import os
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import pytest

from runtime.access import keys
from runtime.formats.mcap_log import McapReader

ROOT = Path(__file__).resolve().parents[2]
ROBOT, LAPTOP = "10.77.31.1", "10.77.31.2"

KNOWN_CELLS = 300 * 300

ROBOT_SIDE = """
    import contextlib, json, subprocess, sys, threading, time
    import numpy as np
    from pathlib import Path
    from runtime.bus import links
    from runtime.bus.contract import Mailbox
    from runtime.bus.zenoh_bus import ZenohBus
    from runtime.clock import Clock
    from runtime.process.identity import Identity, tell
    from runtime.process.node import BusPort
    from runtime.bus.offset import tell_time
    from runtime.tiles import Tiles
    from runtime.topics import topic
    run_dir, address = Path(sys.argv[1]), sys.argv[2]
    hub = [sys.executable, "-m", "runtime.supervision.hub", "--run-dir", str(run_dir), "--remote", f"{address}:7448"]
    with subprocess.Popen(hub) as process, contextlib.ExitStack() as last:
        last.callback(process.terminate)
        while not (run_dir / "hub.sock").exists():
            time.sleep(0.01)
        peer = ZenohBus(links.peer(run_dir, "base"))
        with BusPort("base", lambda: peer, subscribes=("cmd_vel",), publishes=("scan", "map")) as port:
            commands = port.subscribe("cmd_vel", keep=256, raw=True)
            port.ready()
            ahead = Clock(Clock().offset_ns + 3_600_000_000_000)
            tell_time(peer, "robot", ahead if "ahead" in sys.argv else Clock())
            tell(peer, "robot", Identity(seed=5, version="1.2", host="onboard", config="nodes: {}"))
            port.answer("keep", lambda asked: b"/there/ring-kept")
            secret = peer.publisher("0/other/secret")
            tiles = Tiles(250_000)
            cells = np.random.default_rng(1).integers(0, 101, (300, 300))
            tiles.take(cells.astype(np.int8), 0.05, (0.0, 0.0), 5, 6)
            port.answer("map", tiles.answer)
            port.publish_raw("map", bytes(1_000_000))
            stop = threading.Event()
            threading.Thread(target=lambda: (sys.stdin.readline(), stop.set()), daemon=True).start()
            print("up", flush=True)
            while not stop.wait(0.02):
                port.publish_raw("scan", bytes(2800))
                secret.put(b"x", b"")
            print(json.dumps({"commands": commands.received}), flush=True)
"""

GUEST_SIDE = """
    import json, sys, time
    from runtime.access import gate, keys
    from runtime import messages
    from runtime.bus.contract import Mailbox, wait_matching
    from runtime.bus.zenoh_bus import BusError, ZenohBus
    from runtime.clock import Clock
    from runtime.bus.offset import measured
    from runtime.bus.pulling import Puller
    from runtime.topics import topic
    def key(name): return messages.topic_key(f"robot/{name}", topic(name).type)
    config = gate.visit("robot")
    config["connect"]["timeout_ms"] = 3000
    config["mode"], _, name = sys.argv[2].partition(" ")
    if name:  # a guest that makes its own rules; the robot's sockets are files, which no other machine has
        config["id"] = name
        config["transport"]["link"]["protocols"] = ["tls", "tcp"]
        config["listen"] = {"endpoints": ["tcp/10.77.31.2:0"]}
    if len(sys.argv) > 3:
        config["connect"]["endpoints"] = [sys.argv[3]]
        config["transport"]["link"].pop("tls", None)
    try:
        bus = ZenohBus(config)
    except BusError as error:
        print(json.dumps({"refused": str(error)}))
        sys.exit()
    with bus:
        boxes = {"scan": Mailbox(256), "map": Mailbox(2), "secret": Mailbox(2)}
        bus.subscribe(key("scan"), boxes["scan"].put)
        bus.subscribe(key("map"), boxes["map"].put, latched=True)
        bus.subscribe("0/other/**", boxes["secret"].put)
        boxes["tiles"] = Mailbox(64)
        puller = Puller(bus, "robot", key("map"), boxes["tiles"].put)
        stick = bus.publisher(key("cmd_vel"))
        wait_matching(stick, 1.0)
        for sequence in range(1, 21):
            stick.put(bytes(60), messages.Attachment(sequence, 0, bytes(16)).encode())
            time.sleep(0.1)
        offset = measured(bus, "robot", Clock())
        end = time.monotonic() + (20 if boxes["scan"].received else 0)
        known = 0
        while known < int(sys.argv[1]) and time.monotonic() < end:
            if (arrival := boxes["tiles"].take(0.1)) is not None:
                picture = messages.decode(bytes(arrival.payload), topic("map").type)
                known = int((picture.data >= 0).sum())
        puller.close()
        nodes = [messages.node_of_token(t) for t in bus.tokens("@ros2_lv/0/**")]
        print(json.dumps({
            "refused": "", "scans": boxes["scan"].received, "secrets": boxes["secret"].received,
            "map_bytes": max((len(bytes(a.payload)) for a in boxes["map"].take_all()), default=0),
            "nodes": [n for n in nodes if n], "offset_ms": offset and offset.offset_ns / 1e6,
            "known_cells": known,
        }))
"""

STAYING_GUEST = """
    import json, sys, threading, time
    from runtime.access import gate
    from runtime import messages
    from runtime.bus.contract import Mailbox
    from runtime.bus.zenoh_bus import ZenohBus
    from runtime.topics import topic
    def key(name): return messages.topic_key(f"robot/{name}", topic(name).type)
    stop = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.readline(), stop.set()), daemon=True).start()
    with ZenohBus(gate.visit("robot")) as bus:
        scans = Mailbox(1)
        bus.subscribe(key("scan"), scans.put)
        stick = bus.publisher(key("cmd_vel"))
        sent = 0
        while not stop.wait(0.05):
            sent += 1
            stick.put(bytes(60), messages.Attachment(sent, 0, bytes(16)).encode())
            print(json.dumps({"sent": sent, "scans": scans.received}), flush=True)
"""


def network(*command):
    return subprocess.run(["ip", *command], capture_output=True, text=True, check=False)


@pytest.fixture(scope="module")
def namespaces():
    """Two network namespaces with a wire between them."""
    robot, laptop = f"hallway-r{os.getpid()}", f"hallway-l{os.getpid()}"
    made = [network("netns", "add", name) for name in (robot, laptop)]
    wires = [
        ("link", "add", "hw0", "netns", robot, "type", "veth", "peer", "name", "hw0", "netns", laptop),
        *(("-n", ns, "addr", "add", f"{a}/24", "dev", "hw0") for ns, a in ((robot, ROBOT), (laptop, LAPTOP))),
        *(("-n", ns, "link", "set", dev, "up") for ns in (robot, laptop) for dev in ("lo", "hw0")),
    ]
    made += [network(*wire) for wire in wires]
    try:
        if bad := [done.stderr.strip() for done in made if done.returncode]:
            if os.environ.get("CI_REQUIRE_NETNS"):
                pytest.fail(f"network namespaces: {bad[0]}")
            pytest.skip(f"needs network namespaces: {bad[0]}")
        yield robot, laptop
    finally:
        for name in (robot, laptop):
            network("netns", "del", name)


class Robot:
    """A robot in its namespace, and guests in the other."""

    def __init__(self, folder, namespaces):
        self.folder, (self.here, self.there) = folder, namespaces
        self.process = None
        (folder / "run").mkdir(mode=0o700)

    def environment(self, user):
        return {
            **os.environ,
            "PYTHONPATH": str(ROOT),
            "HALLWAY_KEYS": str(self.folder / user),
            "HALLWAY_RUN": str(self.folder / f"{user}-run"),
        }

    def invite(self, guest, role):
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("HALLWAY_KEYS", str(self.folder / "owner"))
            invitation = keys.invite("robot", guest, role, ROBOT)
            file = self.folder / f"{guest}.invitation"
            keys.write_private(file, invitation.to_bytes())
            patch.setenv("HALLWAY_KEYS", str(self.folder / guest))
            keys.pair(file)

    def started(self, *words):
        """Start the robot, which ends with the block; its log is in a file."""
        log = (self.folder / "robot.log").open("w")
        self.process = subprocess.Popen(
            [
                "ip",
                "netns",
                "exec",
                self.here,
                sys.executable,
                "-c",
                textwrap.dedent(ROBOT_SIDE),
                str(self.folder / "run"),
                ROBOT,
                *words,
            ],
            env=self.environment("owner"),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        )
        log.close()
        if self.process.stdout.readline() != "up\n":
            self.process.communicate()
            raise AssertionError((self.folder / "robot.log").read_text())
        return self

    def __enter__(self):
        return self if self.process is not None else self.started()

    def __exit__(self, *_):
        if self.process.poll() is None:
            self.commands()

    def guest(self, name, mode="client", endpoint=None):
        done = subprocess.run(
            [
                "ip",
                "netns",
                "exec",
                self.there,
                sys.executable,
                "-c",
                textwrap.dedent(GUEST_SIDE),
                str(KNOWN_CELLS),
                mode,
                *([endpoint] if endpoint else []),
            ],
            env=self.environment(name),
            capture_output=True,
            text=True,
            timeout=60,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    def staying(self, name):
        """Start a guest that looks and drives until it is told to end, and says how it goes."""
        command = ["ip", "netns", "exec", self.there, sys.executable, "-c", textwrap.dedent(STAYING_GUEST)]
        pipe = subprocess.PIPE
        return subprocess.Popen(
            command, env=self.environment(name), stdin=pipe, stdout=pipe, text=True, bufsize=1
        )

    def typed(self, name, *words):
        """Start a command as a guest types it."""
        command = ["ip", "netns", "exec", self.there, sys.executable, "-m", "runtime.cli", *map(str, words)]
        pipe = subprocess.PIPE
        return subprocess.Popen(
            command, env=self.environment(name), cwd=self.folder, stdout=pipe, stderr=pipe, text=True
        )

    def commands(self):
        """End the robot; return how many commands reached its wheels."""
        out, _ = self.process.communicate("end\n", timeout=30)
        return json.loads(out)["commands"]


@pytest.fixture
def robot(tmp_path, namespaces, monkeypatch):
    monkeypatch.setenv("HALLWAY_KEYS", str(tmp_path / "owner"))
    keys.make("robot", [ROBOT])
    return Robot(tmp_path, namespaces)


def test_a_viewer_sees_everything_of_its_robot_and_drives_nothing(robot):
    robot.invite("anna", "viewer")
    with robot:
        seen = robot.guest("anna")
        assert seen["scans"] > 50
        assert seen["map_bytes"] == 1_000_000
        assert seen["known_cells"] == KNOWN_CELLS
        assert seen["nodes"] == ["base"]
        assert seen["secrets"] == 0
        assert abs(seen["offset_ms"]) < 50  # one machine, two clocks of it
        assert robot.commands() == 0


def test_a_guest_records_what_the_run_is_and_how_far_its_clock_is(robot, tmp_path):
    robot.invite("anna", "viewer")
    with robot.started("ahead"):
        recorder = robot.typed("anna", "record", "--duration", "1", "--out", "a.mcap")
        _, told = recorder.communicate(timeout=60)
    assert recorder.returncode == 0, told
    reader = McapReader(tmp_path / "a.mcap")
    assert sum(message.channel.name == "scan" for message in reader.messages()) > 20
    about = reader.state.metadata["hallway"]
    assert (about["seed"], about["robot.version"], about["robot.host"]) == ("5", "1.2", "onboard")
    assert reader.state.run_config == "nodes: {}"
    off_s = (int(about["robot.clock_ahead_ns"]) - 3_600_000_000_000) / 1e9
    assert abs(off_s) <= int(about["robot.clock_ahead_error_ns"]) / 1e9 + 0.05  # two clocks of one machine


def test_a_guest_keeps_the_ring_of_the_robot_there_and_one_of_its_own_here(robot, tmp_path):
    robot.invite("anna", "viewer")
    with robot:
        keeper = robot.typed("anna", "record", "--keep")
        assert keeper.communicate(timeout=60) == ("on the robot: /there/ring-kept\n", "")
        recorder = robot.typed("anna", "record", "--ring", "10", "--duration", "0.5", "--out", "a.mcap")
        _, told = recorder.communicate(timeout=60)
        assert recorder.returncode == 0, told
        keeper = robot.typed("anna", "record", "--keep", "--out", "kept")
        _, told = keeper.communicate(timeout=60)
        assert keeper.returncode == 0, told
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["a_00000000.mcap"]


def test_no_secret_is_in_a_log_a_recording_or_a_list_of_processes(robot, tmp_path):
    robot.invite("olga", "operator")
    secrets = secrets_of(tmp_path)
    assert len(secrets) >= 9
    with robot:
        recorder = robot.typed("olga", "record", "--duration", "2", "--out", "a.mcap")
        running = b""
        while recorder.poll() is None:
            running += b"".join(map(command_line, Path("/proc").glob("[0-9]*")))
            time.sleep(0.1)
        said = "".join(recorder.communicate()).encode()
        robot.invite("anna", "viewer")  # which the hub has to say something about
        end = time.monotonic() + 20
        while not (log := (tmp_path / "robot.log").read_bytes()) and time.monotonic() < end:
            time.sleep(0.1)
    assert b"runtime.supervision.hub" in running
    assert b"a.mcap" in running
    reader = McapReader(tmp_path / "a.mcap")
    recorded = b"".join(message.payload for message in reader.messages())
    recorded += repr(reader.state).encode()
    for where in (running, said, log, recorded):
        assert len(where) > 20
        assert [secret for secret in secrets if secret in where] == []


def secrets_of(folder):
    """Return pieces of every private key that was made, as PEM and as the settings of a session have it."""
    texts = [path.read_text() for path in (folder / "owner").rglob("*.key")]
    texts += [keys.Invitation.read(path).key for path in folder.rglob("paired/*.json")]
    pieces = [line for text in texts for line in text.splitlines() if not line.startswith("-----")]
    pieces += [base64.b64encode(text.encode()).decode()[60:120] for text in texts]
    return [piece.encode() for piece in pieces if len(piece) > 40]


def command_line(process):
    try:
        return (process / "cmdline").read_bytes()
    except OSError:
        return b""  # it has ended


def test_an_operator_sees_and_drives(robot):
    robot.invite("olga", "operator")
    with robot:
        seen = robot.guest("olga")
        assert seen["scans"] > 50
        assert robot.commands() >= 15


@pytest.mark.parametrize("mode", ["peer 1", "peer fedcba9876543210fedcba9876543210", "router 1"])
def test_a_guest_that_calls_itself_a_peer_or_a_router_gets_past_no_rule(robot, mode):
    # Of two peers the one with the greater name dials; the robot's would dial a guest that listens.
    robot.invite("anna", "viewer")
    with robot:
        seen = robot.guest("anna", mode=mode)
        assert seen["refused"] == ""
        assert (seen["secrets"], robot.commands()) == (0, 0)
        assert (seen["scans"] > 50) is mode.startswith("router")  # which passes on what its guest may see


def test_whoever_has_no_invitation_or_one_of_another_robot_is_refused(robot, tmp_path, monkeypatch):
    robot.invite("anna", "viewer")
    monkeypatch.setenv("HALLWAY_KEYS", str(tmp_path / "stranger-owner"))
    keys.make("robot", [ROBOT])
    forged = keys.invite("robot", "anna", "operator", ROBOT)
    monkeypatch.setenv("HALLWAY_KEYS", str(tmp_path / "stranger"))
    keys.write_private(tmp_path / "forged.invitation", forged.to_bytes())
    keys.pair(tmp_path / "forged.invitation")
    with robot:
        assert "cannot be reached" in robot.guest("stranger")["refused"]
        for endpoint in (f"tcp/{ROBOT}:7448", f"tls/{ROBOT}:7448", f"tcp/{ROBOT}:7447"):
            assert "cannot be reached" in robot.guest("anna", endpoint=endpoint)["refused"]
        assert robot.commands() == 0


def test_who_was_struck_off_the_list_sees_and_moves_nothing(robot, tmp_path, monkeypatch):
    robot.invite("olga", "operator")
    robot.invite("anna", "viewer")
    monkeypatch.setenv("HALLWAY_KEYS", str(tmp_path / "owner"))
    keys.revoke("robot", "olga")
    with robot:
        seen = robot.guest("olga")
        assert (seen["scans"], seen["map_bytes"], seen["nodes"], seen["offset_ms"]) == (0, 0, [], None)
        assert seen["known_cells"] == 0
        assert robot.guest("anna")["scans"] > 50
        assert robot.commands() == 0


def state(guest):
    return json.loads(guest.stdout.readline())


def until(guest, condition, turns=600):
    """Read what a guest says, twenty times a second, until it says what is waited for."""
    for _ in range(turns):
        if condition(said := state(guest)):
            return said
    raise AssertionError(f"never came: {said}")


def without_news(guest):
    """Wait until a guest has seen no scan for two seconds; return what it said at their beginning."""
    last, since = state(guest), 0
    for _ in range(600):
        said = state(guest)
        since = since + 1 if said["scans"] == last["scans"] else 0
        if not since:
            last = said
        if since == 40:
            return last
    raise AssertionError("it still sees scans after half a minute")


def test_who_is_struck_off_while_inside_is_out_and_the_others_come_back_by_themselves(
    robot, tmp_path, monkeypatch
):
    robot.invite("olga", "operator")
    robot.invite("anna", "viewer")
    monkeypatch.setenv("HALLWAY_KEYS", str(tmp_path / "owner"))
    with robot, robot.staying("olga") as olga, robot.staying("anna") as anna:
        for guest in (olga, anna):
            until(guest, lambda said: said["scans"] > 20)
        keys.revoke("robot", "olga")
        blind = without_news(olga)
        until(olga, lambda said: said["sent"] >= blind["sent"] + 60)
        assert state(olga)["scans"] == blind["scans"]
        seen = state(anna)["scans"]
        until(anna, lambda said: said["scans"] > seen + 50)
        for guest in (olga, anna):
            guest.communicate("end\n", timeout=30)
        assert robot.commands() <= blind["sent"] + 5  # of more than sixty that she sent after that


def test_the_robot_listens_at_its_one_door_only(robot):
    robot.invite("anna", "viewer")
    with robot:
        done = subprocess.run(
            ["ip", "netns", "exec", robot.here, "cat", "/proc/net/tcp", "/proc/net/tcp6", "/proc/net/udp"],
            capture_output=True,
            text=True,
            check=True,
        )
        rows = [line.split() for line in done.stdout.splitlines() if not line.strip().startswith("sl")]
        listening = [row[1] for row in rows if row[3] == "0A"]
        assert [address.split(":")[1] for address in listening] == [f"{7448:04X}"]
        assert "cannot be reached" not in robot.guest("anna")["refused"]
