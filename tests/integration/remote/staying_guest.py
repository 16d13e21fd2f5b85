"""A guest that looks and drives until it is told to end, and says how it goes."""

import json
import sys
import threading

from runtime import messages
from runtime.access import gate
from runtime.bus.contract import Mailbox
from runtime.bus.zenoh_bus import ZenohBus
from runtime.topics import topic


def key(name):
    return messages.topic_key(f"robot/{name}", topic(name).type)


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
