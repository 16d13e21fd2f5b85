"""A guest that looks at everything, drives for two seconds, and says what it saw.

    python guest_side.py CELLS "MODE [ID]" [ENDPOINT]

It waits for CELLS known cells of the map. MODE with an ID makes rules of its own; ENDPOINT is another door.
"""

import json
import sys
import time

from runtime import messages
from runtime.access import gate
from runtime.bus.contract import Mailbox, wait_matching
from runtime.bus.offset import measured
from runtime.bus.pulling import Puller
from runtime.bus.zenoh_bus import BusError, ZenohBus
from runtime.clock import Clock
from runtime.topics import topic


def key(name):
    return messages.topic_key(f"robot/{name}", topic(name).type)


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
    print(
        json.dumps(
            {
                "refused": "",
                "scans": boxes["scan"].received,
                "secrets": boxes["secret"].received,
                "map_bytes": max((len(bytes(a.payload)) for a in boxes["map"].take_all()), default=0),
                "nodes": [n for n in nodes if n],
                "offset_ms": offset and offset.offset_ns / 1e6,
                "known_cells": known,
            }
        )
    )
