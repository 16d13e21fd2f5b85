"""How far stamps are from the truth: drift of 0.2 %, jitter, and a step of the host's clock in the middle.

The emulator knows when each first ray was really taken; the driver reads it over a pseudo-terminal.
python tests/bench/urg_stamps.py [--seconds 60]
"""

import argparse
import json
import os

import numpy as np

from drivers.urg04lx.emulator import PERIOD_NS, Emulator
from drivers.urg04lx.model import Mode
from drivers.urg04lx.pair import Session, attach


def errors_ms(seconds: float, drift: float, step_s: float) -> tuple[list[float], int, int]:
    """Return the error of every stamp, in order, and the scans and jumps of the clock map."""
    with Emulator(mode=Mode.IDLE, drift=drift) as emulator, Session(attach(emulator), emulator) as session:
        session.more_scans(max(1, round(seconds * 5)), seconds + 20.0)
        if step_s:
            emulator.step_host_clock(step_s)
        session.more_scans(max(1, round(seconds * 5)), seconds + 20.0)
        truth = {stamp: step_0_ns + 44 * PERIOD_NS // 1024 for stamp, step_0_ns in emulator.sweeps}
    errors = []
    for scan in session.scans:
        error_ns = scan.stamp_ns - truth[scan.sensor_ms]
        # A scan that was on its way during the step has a time before and after it.
        if step_s and abs(error_ns - step_s * 1e9) < abs(error_ns):
            error_ns -= round(step_s * 1e9)
        errors.append(error_ns / 1e6)
    return errors, len(session.scans), session.device.clock.jumps


def figures(errors: list[float]) -> dict[str, float]:
    array = np.array(errors)
    return {
        "rms_ms": round(float(np.sqrt(np.mean(array**2))), 3),
        "max_ms": round(float(np.abs(array).max()), 3),
        "mean_ms": round(float(array.mean()), 3),
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    seconds = parser.parse_args().seconds
    for drift, step_s in ((0.0, 0.0), (0.002, 0.0), (-0.002, 0.0), (0.002, 1.0), (0.002, -1.0)):
        errors, scans, jumps = errors_ms(seconds, drift, step_s)
        print(
            json.dumps(
                {
                    "bench": "urg_stamps",
                    "drift": drift,
                    "step_s": step_s,
                    "scans": scans,
                    "jumps": jumps,
                    **figures(errors),
                    "first 2 s": figures(errors[:20]),
                    "load": round(os.getloadavg()[0], 1),
                }
            ),
            flush=True,
        )
