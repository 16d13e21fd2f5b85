"""The robot: its hub with a door for guests, and one process that says scans, a map and what the run is.

    python robot_side.py RUN_DIR ADDRESS [ahead]

At the end it says how many commands came to its wheels. `ahead`: its clock is an hour ahead.
"""

import contextlib
import json
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

from runtime.bus import links
from runtime.bus.offset import tell_time
from runtime.bus.zenoh_bus import ZenohBus
from runtime.clock import Clock
from runtime.process.identity import Identity, tell
from runtime.process.node import BusPort
from runtime.tiles import Tiles

run_dir, address = Path(sys.argv[1]), sys.argv[2]
hub = [
    sys.executable,
    "-m",
    "runtime.supervision.hub",
    "--run-dir",
    str(run_dir),
    "--remote",
    f"{address}:7448",
]
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
