"""An independent rmw_zenoh client at a robot of real processes: through its own router, as a guest with keys.

`zenoh-ros2-sdk` finds the topics by their tokens, decodes them, and drives; the type support of ROS 2 reads
what it received. Skips by name where `tests/ros/requirements.txt` is not installed.
"""

import json
import os
import signal
import socket
import subprocess
import sys
import time

import numpy as np
import pytest

from runtime import messages
from runtime.topics import topic
from tests.ros.machine import HERE, ROOT, ask, ros_environment, ros_python
from tests.ros.padding import same_but_for_padding

GRAPH = """
robot: robot
seed: 1
nodes:
  simulator: {module: simulator, config: {building: room}}
  mapper: {module: mapper, stop_s: 20}
  matcher: {module: matcher, config: {laser_in_base: [0.1, 0.0, 0.0]}}
  base: {module: base, after: [simulator], config: {path: base}}
  laser: {module: laser, after: [simulator, matcher, mapper], config: {path: laser}}
"""
HEARD = (
    *("scan", "odom", "match_points", "pose", "map", "trajectory", "tf", "tf_static", "particles"),
    *("battery", "diagnostics", "truth"),
)
LATCHED = ("map", "trajectory", "tf_static")


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def until(condition, within_s, what):
    end = time.monotonic() + within_s
    while not (value := condition()):
        assert time.monotonic() < end, f"waited {within_s} s for {what}"
        time.sleep(0.05)
    return value


class Robot:
    """A robot in a simulated room, its door open on the loopback, and machines with ROS 2 as its guests."""

    def __init__(self, folder):
        self.folder, self.port = folder, free_port()
        own = {key: value for key, value in os.environ.items() if not key.startswith("HALLWAY")}
        self.environment = {
            **own,
            "PYTHONPATH": str(ROOT),
            "HALLWAY_RUN": str(folder / "run"),
            "HALLWAY_KEYS": str(folder / "keys"),
        }
        (folder / "g.yaml").write_text(GRAPH)
        self.hallway("keys", "make")

    def command(self, *arguments):
        return [sys.executable, "-m", "runtime.cli", *map(str, arguments)]

    def hallway(self, *arguments):
        done = subprocess.run(
            self.command(*arguments),
            cwd=self.folder,
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=120,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        return done.stdout

    def __enter__(self):
        arguments = ("up", "g.yaml", "--headless", "--out", "res", "--remote", f"127.0.0.1:{self.port}")
        self.up = subprocess.Popen(
            self.command(*arguments), cwd=self.folder, env=self.environment, stdout=subprocess.DEVNULL
        )
        until((self.folder / "run" / "robot" / "hub.sock").exists, 200, "the hub")
        return self

    def __exit__(self, *_):
        self.up.send_signal(signal.SIGINT)
        self.up.wait(timeout=60)

    def guest(self, name, role, **question):
        """Pair a machine with ROS 2 as `hallway keys` says, and return what its client tells."""
        invited = ("keys", "invite", name, "--role", role, "--address", f"127.0.0.1:{self.port}")
        self.hallway(*invited)
        self.hallway("keys", "ros", f"{name}.invitation")
        file = self.folder / f"{name}.json5"
        assert file.stat().st_mode & 0o077 == 0
        # Its own place on this machine, which has but one localhost:7447.
        config, port = json.loads(file.read_text()), free_port()
        assert config["listen"]["endpoints"] == ["tcp/localhost:7447"]
        config["listen"]["endpoints"] = [f"tcp/127.0.0.1:{port}"]
        file.write_text(json.dumps(config))
        pipe = subprocess.PIPE
        command = [ros_python(), HERE / "router.py", file]
        with subprocess.Popen(command, env=ros_environment(), stdin=pipe, stdout=pipe, text=True) as router:
            try:
                assert router.stdout.readline() == "up\n"
                topics = {f"/robot/{one}": topic(one).type for one in HEARD}
                asked = {
                    "topics": topics,
                    "latched": [f"/robot/{one}" for one in LATCHED],
                    "router": ["127.0.0.1", port],
                    "state": "/robot/diagnostics",
                    "within_s": 60.0,
                    **question,
                }
                return ask("client.py", asked, within_s=120.0)
            finally:
                router.stdin.close()


@pytest.fixture(scope="module")
def robot(tmp_path_factory):
    ros_python()
    with Robot(tmp_path_factory.mktemp("robot")) as running:
        yield running


@pytest.fixture(scope="module")
def told(robot):
    """What an operator's client tells, that drove the robot for two seconds."""
    return robot.guest("olga", "operator", drive="/robot/cmd_vel")


@pytest.mark.timeout(400)
@pytest.mark.parametrize("name", HEARD)
def test_what_the_client_decodes_is_what_ros_reads_and_what_we_mean(name, told):
    heard = told["heard"][f"/robot/{name}"]
    ours = messages.decode(bytes.fromhex(heard["payload"]), topic(name).type)
    assert same_but_for_padding(ours, bytes.fromhex(heard["ros"]["payload"]))
    assert json.dumps(heard["client"][-1]) == json.dumps(heard["ros"]["fields"])
    assert heard["ros"]["by"] == ("Cyclone DDS" if name.startswith("tf") else "ROS 2")


@pytest.mark.timeout(400)
def test_the_client_sees_the_room_and_where_the_robot_is_in_it(told):
    heard = {name: told["heard"][f"/robot/{name}"]["client"] for name in HEARD}
    scan = heard["scan"][-1]
    assert (scan["header"]["frame_id"], len(scan["ranges"])) == ("laser", 682)
    assert np.isfinite(scan["ranges"]).mean() > 0.5
    grid = heard["map"][-1]
    assert len(grid["data"]) == grid["info"]["width"] * grid["info"]["height"] > 0
    assert set(grid["data"]) <= set(range(-1, 101))
    assert min(grid["data"]) == -1
    assert max(grid["data"]) > 65  # a wall
    transforms = [one for name in ("tf", "tf_static") for sent in heard[name] for one in sent["transforms"]]
    parents = {one["child_frame_id"]: one["header"]["frame_id"] for one in transforms}
    assert parents == {"odom": "map", "base_link": "odom", "laser": "base_link"}  # as REP-105 has them


@pytest.mark.timeout(400)
def test_the_client_finds_each_publisher_by_its_tokens(told):
    for name, node in (("scan", "laser"), ("odom", "matcher"), ("map", "mapper"), ("battery", "base")):
        (one,) = told["publishers"][f"/robot/{name}"]
        assert (one["node_namespace"], one["node_name"]) == ("/robot", node)
        assert (one["topic_type"], one["type_hash"]) == (
            topic(name).type,
            messages.type_hash(topic(name).type),
        )
        assert one["qos"].startswith(":1:" if topic(name).latched else "::")
    assert {one["node_name"] for one in told["publishers"]["/robot/tf"]} == {"matcher", "mapper"}


@pytest.mark.timeout(400)
def test_the_attachments_number_the_messages(told):
    attached = [bytes.fromhex(one) for one in told["heard"]["/robot/truth"]["attachments"]]
    read = [messages.Attachment.decode(one) for one in attached]
    numbers = [one.sequence for one in read]
    assert len(numbers) > 10
    assert numbers == sorted(set(numbers))
    assert np.median(np.diff(numbers)) == 1  # a busy machine may lose one
    assert len({one.gid for one in read}) == 1


def driven_m(told):
    """How far the robot went while a client was there."""
    places = [one["pose"]["position"] for one in told["heard"]["/robot/truth"]["client"]]
    return np.hypot(places[-1]["x"] - places[0]["x"], places[-1]["y"] - places[0]["y"])


@pytest.mark.timeout(400)
def test_an_operator_drives_from_ros_and_a_viewer_does_not(robot, told):
    assert driven_m(told) > 0.1
    seen = robot.guest("anna", "viewer", drive="/robot/cmd_vel", within_s=6.0)
    assert len(seen["heard"]["/robot/scan"]["client"]) > 10
    assert driven_m(seen) < 0.01


@pytest.mark.timeout(400)
def test_who_comes_late_has_the_latched_topics_at_once(robot, told):
    assert told["heard"]["/robot/map"]["client"]
    late = robot.guest("lena", "viewer", drive="", within_s=0.0)  # what is asked for, and nothing else
    for name in LATCHED:
        assert late["heard"][f"/robot/{name}"]["client"], name
