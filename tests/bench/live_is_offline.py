"""One drive, three times: as it was driven, replayed at its own pace through live processes, and offline.

    python tests/bench/live_is_offline.py [--seconds 60]

The demo runs with a recorder. Its recording goes through live matcher and mapper (`hallway replay --map`, 1x)
and through one process (`hallway map`). Trajectory, odometry and map must be the same to the last byte where
no scan was left out; where one was, that is said.
"""

import argparse
import hashlib
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT))

MEMORY = "/dev/shm" if Path("/dev/shm").is_dir() else None
"""As a run's directory is on a robot with systemd: not on a disk that others use."""

from runtime import config, graph  # noqa: E402

FILES = ("trajectory.tum", "odometry.tum", "map.pgm", "map.yaml")


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    args = parser.parse_args()
    with tempfile.TemporaryDirectory(prefix="hw", dir=MEMORY) as name:
        folder = Path(name)
        data = config.load_yaml(graph.find("demo"))
        del data["nodes"]["viewer"]
        data["nodes"]["recorder"] = {"module": "recorder", "required": False}
        data["nodes"]["laser"]["after"].append("recorder")
        (folder / "demo.yaml").write_text(config.to_yaml(data))
        run = hallway(folder, "up", "demo.yaml", "--duration", args.seconds, "--out", "driven", "--headless")
        recording = next((folder / "driven").rglob("recording.mcap"))
        played = hallway(folder, "replay", recording, "--map", "--out", "replayed")
        mapped = hallway(folder, "map", recording, "--out", "offline")
        sums = {way: digests(folder / way) for way in ("driven", "replayed", "offline")}
    latency = run["metrics"]["latency"]
    print(f"driven: {latency['mapped']} of {latency['scans']} scans, {latency['late']} late")
    print(f"replayed at 1x: {played['mapped']} of {played['sent']} scans, {len(played['missing'])} missing")
    print(f"offline: {mapped['scans']} scans")
    for file in FILES:
        row = "  ".join(f"{way} {sums[way][file]}" for way in sums)
        same = {way: sums[way][file] == sums["offline"][file] for way in sums}
        print(f"{file:15} {row}  {'the same' if all(same.values()) else 'DIFFERENT'}")
    print(json.dumps({"bench": "live_is_offline", "load": round(os.getloadavg()[0], 1)}))


def hallway(folder, verb, *arguments):
    """Run a verb; return what it says to machines."""
    environment = {**os.environ, "HALLWAY_RUN": f"{folder}/run", "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-m", "runtime.cli", verb, *map(str, arguments), "--json"]
    began = time.monotonic()
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=False)
    print(f"{verb}: exit code {done.returncode} after {time.monotonic() - began:.0f} s {done.stderr[-200:]}")
    return json.loads(done.stdout)


def digests(folder):
    return {file: hashlib.sha256((folder / file).read_bytes()).hexdigest()[:12] for file in FILES}


if __name__ == "__main__":
    main()
