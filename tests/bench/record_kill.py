"""Kill a recorder at random moments and read back what it left; `python tests/bench/record_kill.py [KILLS]`.

Prints one JSON object: how much recorded time each kill cost, and whether anything that was flushed was lost.
The child publishes on a bus in memory at the rate of a real robot, so that only the recorder is on trial.
"""

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SCAN_BYTES = 2816
CHILD = """
import sys, threading, time
sys.path.insert(0, {root!r})
from runtime.bus.memory import MemoryBus
from runtime.formats.mcap_writer import McapWriter
from runtime.process.identity import Identity
from runtime.process.node import BusPort
from runtime.nodes import recorder
from runtime.recordings.recording import RecordingConfig
flush = McapWriter.flush
sent = 0
def told_flush(self, to_disk=False):
    before = recording_counts()
    flush(self, to_disk)
    print("flushed", before, flush=True) if before is not None else None
McapWriter.flush = told_flush
recording = []
def recording_counts():
    return recording[0].counts.written if recording else None
bus = MemoryBus()
source = BusPort("source", lambda: bus.join(), publishes=("scan", "odom", "map"))
def publish():
    global sent
    began = time.monotonic()
    while True:
        sent += 1
        source.publish_raw("scan", sent.to_bytes(4, "little") * {words})
        source.publish_raw("odom", b"odom" * 180)
        if sent % 20 == 0:
            source.publish_raw("map", bytes(200_000))
        print("sent", sent, flush=True)
        time.sleep(max(0.0, began + sent * {period} - time.monotonic()))
port = BusPort("recorder", lambda: bus.join(), subscribes=recorder.SUBSCRIBES)
config = recorder.Config(file={file!r}, recording=RecordingConfig(min_free_mb=0.0, split_s={split}))
def turn(now):
    if not recording:
        recording.append(now)
        threading.Thread(target=publish, daemon=True).start()
recorder.record(port, config, turn, Identity())
"""


def kill_once(folder: Path, after_s: float, period_s: float = 0.1, split_s: float = 0.0) -> dict[str, float]:
    """Let a recorder run for a while, kill it, and compare the file with what the child said.

    Returns:
        Scans sent, scans read back, messages that were flushed and not read back, and scans out of order.
    """
    from runtime.formats.mcap_log import McapReader

    code = CHILD.format(
        root=str(ROOT), file=str(folder / "a.mcap"), words=SCAN_BYTES // 4, period=period_s, split=split_s
    )
    child = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True, cwd=ROOT)
    assert child.stdout is not None
    first = child.stdout.readline()
    while first and not first.startswith("sent"):
        first = child.stdout.readline()
    time.sleep(after_s)
    child.send_signal(signal.SIGKILL)
    said = first.split("\n") + child.stdout.read().splitlines()
    child.wait()
    child.stdout.close()
    last = {"sent": 0, "flushed": 0}
    for line in said:
        word, _, number = line.partition(" ")
        if word in last and number.isdigit():  # the last line may be cut
            last[word] = int(number)
    read, scans = 0, []
    for path in sorted(folder.glob("a*.mcap*")):
        reader = McapReader(path)
        for message in reader.messages():
            read += message.channel.name != "recording"
            if message.channel.name == "scan":
                scans.append(message.sequence)
    return {
        "sent": last["sent"],
        "read": len(scans),
        "flushed_and_lost": max(0, last["flushed"] - read),
        "out_of_order": sum(1 for expected, found in enumerate(scans, start=1) if expected != found),
    }


def main(kills: int) -> int:
    """Kill so often and print the figures; 1 if anything that was flushed is missing."""
    random.seed(kills)
    lost_s, broken = [], 0
    for n in range(kills):
        with tempfile.TemporaryDirectory() as name:
            result = kill_once(Path(name), random.uniform(0.0, 4.0), split_s=1.0 if n % 2 else 0.0)
        lost_s.append(round((result["sent"] - result["read"]) * 0.1, 1))
        broken += bool(result["flushed_and_lost"] or result["out_of_order"])
    lost_s.sort()
    figures = {"p50": lost_s[kills // 2], "max": lost_s[-1]}
    print(json.dumps({"bench": "record_kill", "kills": kills, "broken": broken, "lost_s": figures}))
    return 1 if broken else 0


if __name__ == "__main__":
    sys.path.insert(0, str(ROOT))
    os.chdir(ROOT)
    sys.exit(main(int(sys.argv[1]) if len(sys.argv) > 1 else 100))
