"""From opening the port to the first scan, for every state a sensor may have been left in.

python tests/bench/urg_start.py [--times 5]
"""

import argparse
import json

import numpy as np

from drivers.urg04lx.emulator import Emulator
from drivers.urg04lx.model import URG_04LX_UG01, Mode
from drivers.urg04lx.pair import Session, attach

CASES = {
    "just powered, SCIP 1.1": ({}, {}),
    "UG01 just powered": ({"model": URG_04LX_UG01}, {}),
    "idle": ({"mode": Mode.IDLE}, {}),
    "left streaming": ({"mode": Mode.STREAMING}, {}),
    "time mode": ({"mode": Mode.TIME}, {}),
    "RS-232 at 19200, to 500000": ({"mode": Mode.IDLE, "rs232": True}, {"baud": 500_000}),
    "RS-232 at 115200, to 500000": ({"mode": Mode.IDLE, "rs232": True, "baud": 115_200}, {"baud": 500_000}),
    "RS-232 streaming at 750000, to 500000": (
        {"mode": Mode.STREAMING, "rs232": True, "baud": 750_000},
        {"baud": 500_000},
    ),
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=5)
    times = parser.parse_args().times
    for name, (of_emulator, wanted) in CASES.items():
        took_s = []
        for seed in range(times):
            options = dict(of_emulator)
            baud = options.pop("baud", None)
            with Emulator(seed=seed, **options) as emulator:
                if baud:
                    emulator.sensor.baud = emulator.sensor.next_baud = baud
                began_ns = emulator.now_ns()
                with Session(attach(emulator, **wanted), emulator) as session:
                    assert session.more_scans(1, 60.0), f"{name}: no scan; {session.notices}"
                    took_s.append((emulator.now_ns() - began_ns) / 1e9)
        median, worst = round(float(np.median(took_s)), 2), round(max(took_s), 2)
        print(
            json.dumps({"bench": "urg_start", "state": name, "median_s": median, "max_s": worst}), flush=True
        )
