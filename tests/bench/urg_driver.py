"""CPU share of the laser driver at 10 Hz, alone in its process, on a paced line.

python tests/bench/urg_driver.py [--seconds 30]
"""

import argparse
import json
import subprocess
import sys
import time

from drivers.urg04lx.emulator import Emulator

DRIVER = """
import json, resource, sys, time
from drivers.urg04lx.device import Urg
from drivers.urg04lx.events import UrgScan
from drivers.urg04lx.reader import UrgReader
from drivers.urg04lx.settings import UrgConfig

seconds = float(sys.argv[2])
with UrgReader(Urg(UrgConfig(port=sys.argv[1]))) as reader:
    while not isinstance(reader.read(1.0), UrgScan):
        pass
    cpu_s, began, scans = time.process_time(), time.monotonic(), 0
    while time.monotonic() - began < seconds:
        scans += isinstance(reader.read(0.05), UrgScan)
    print(json.dumps({
        "driver cpu percent": round(100 * (time.process_time() - cpu_s) / (time.monotonic() - began), 2),
        "scans": scans,
        "driver resident MB": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3),
        "damaged": reader.device.decoder.damaged.total(),
        "missed": reader.device.sequence.missed,
    }))
"""

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=30.0)
    seconds = parser.parse_args().seconds
    for chunk_bytes in (64, 2048):
        with Emulator(chunk_bytes=chunk_bytes) as emulator:
            cpu_s, began = time.process_time(), time.monotonic()
            out = subprocess.run(
                [sys.executable, "-c", DRIVER, emulator.port, str(seconds)], capture_output=True, check=True
            ).stdout
            share = 100 * (time.process_time() - cpu_s) / (time.monotonic() - began)
        figures = {"emulator cpu percent": round(share, 2), **json.loads(out)}
        print(json.dumps({"bench": "urg_driver", "bytes a piece": chunk_bytes, **figures}))
