"""A node of an independent rmw_zenoh client: finds topics, decodes, drives; knows nothing of us.

Run by the interpreter of an environment with ROS 2. On stdin one JSON object: `router` (host and port),
`topics` (name to type), `latched` (names), `drive` (a topic of TwistStamped, or empty), `state` (the topic of
diagnostics), `within_s`. On stdout `publishers` (of each topic, as their tokens say) and `heard` (of each
topic: what the client decoded, what ROS 2 reads in the last of it, its bytes, all attachments).
"""

import contextlib
import json
import os
import sys
import tempfile
import time
from pathlib import Path

from type_support import DEFINITIONS, SHARE, answer, plain
from zenoh_ros2_sdk import ROS2Publisher, ROS2Subscriber, get_registry, get_topic_info
from zenoh_ros2_sdk.qos import QosDurability, QosProfile

TWIST = "geometry_msgs/msg/TwistStamped"


class Listener(ROS2Subscriber):
    """A subscription that keeps what came, as bytes and as the client decodes it."""

    def __init__(self, *arguments, **more):
        # The constructor asks for what was said before, and hears it at once.
        self.samples, self.decoded = [], []
        super().__init__(*arguments, callback=self.decoded.append, **more)

    def _process_sample(self, sample):
        attachment = sample.attachment
        self.samples.append((sample.payload.to_bytes(), attachment.to_bytes() if attachment else b""))
        super()._process_sample(sample)

    def _discover_publishers(self):
        # 0.1.8 looks for tokens with only the first '/' of a name written as '%': in a namespace, where
        # rmw_zenoh writes all of them so, it finds nobody whom it could ask for what was said before.
        named, self.topic = self.topic, self.topic.strip("/").replace("/", "%")
        try:
            return super()._discover_publishers()
        finally:
            self.topic = named

    def told(self):
        """What was heard, as JSON has it."""
        decoded = list(self.decoded)  # more may come meanwhile
        last = self.samples[len(decoded) - 1][0] if decoded else None
        return {
            "client": [plain(message) for message in decoded],
            "ros": answer(self.msg_type, last) if last else None,
            "payload": last.hex() if last else "",
            "attachments": [attachment.hex() for _, attachment in self.samples],
        }


def definitions(folder):
    """The .msg files of ROS 2 where the client looks for them; by itself it would clone repositories."""
    for package in {path for share in SHARE for path in share.iterdir() if (path / "msg").is_dir()}:
        (folder / package.name).symlink_to(package)
    for msgtype, text in DEFINITIONS.items():
        if not (file := folder / f"{msgtype}.msg").exists():
            file.parent.mkdir(parents=True)
            file.write_text(text)
    get_registry().messages_dir = folder


class Stick:
    """A person who drives: holds the stick at zero, asks to be let drive, and drives once let."""

    def __init__(self, name, frame, **where):
        self.publisher = ROS2Publisher(name, "geometry_msgs/msg/TwistStamped", **where)
        self.frame, self.turn, self.driven = frame, 0, 0

    def move(self, state):
        """Say what the person wants now; `state` is what the base said of itself."""
        self.turn += 1
        self.driven += state == "armed"
        arm = state == "disarmed" and self.turn % 20 == 0
        types = self.publisher.session_mgr.store.types
        now_ns = time.time_ns()
        stamp = types["builtin_interfaces/msg/Time"](sec=now_ns // 10**9, nanosec=now_ns % 10**9)
        vector = types["geometry_msgs/msg/Vector3"]
        self.publisher.publish(
            header=types["std_msgs/msg/Header"](stamp, f"{self.frame}:arm" if arm else self.frame),
            twist=types["geometry_msgs/msg/Twist"](
                linear=vector(0.2 if state == "armed" else 0.0, 0.0, 0.0), angular=vector(0.0, 0.0, 0.0)
            ),
        )


def state_of_base(diagnostics):
    """What the base said last of itself."""
    said = [status for message in diagnostics for status in message.status if status.name.endswith("/base")]
    return {entry.key: entry.value for entry in said[-1].values}.get("state", "") if said else ""


def main():
    asked = json.load(sys.stdin)
    where = dict(zip(("router_ip", "router_port"), asked["router"], strict=True))
    latched = QosProfile(history_depth=1, durability=QosDurability.TRANSIENT_LOCAL)
    with tempfile.TemporaryDirectory() as folder:
        definitions(Path(folder))
        listening = {
            name: Listener(name, msgtype, qos=latched if name in asked["latched"] else None, **where)
            for name, msgtype in asked["topics"].items()
        }
        stick = Stick(asked["drive"], "ros", **where) if asked["drive"] else None
        end = time.monotonic() + asked["within_s"]
        while time.monotonic() < end:
            if stick is not None:
                stick.move(state_of_base(listening[asked["state"]].decoded))
            if all(one.decoded for one in listening.values()) and (stick is None or stick.driven > 40):
                break
            time.sleep(0.05)
        publishers = {name: get_topic_info(name, verbose=True, **where).publishers for name in listening}
        return {
            "publishers": {name: [vars(one) for one in those] for name, those in publishers.items()},
            "heard": {name: one.told() for name, one in listening.items()},
        }


if __name__ == "__main__":
    with contextlib.redirect_stdout(sys.stderr):
        told = main()
    json.dump(told, sys.stdout, default=str)
    sys.stdout.flush()
    os._exit(0)  # the client's session would wait for threads of its own
