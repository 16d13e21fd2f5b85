"""The odometry holds no more memory after a thousand scans than after its first two hundred."""

import tracemalloc

from drivers.world import Urg04lx, room, simulate_scans
from processing.odometry import LaserOdometry, OdometryConfig
from processing.scan import Scan
from tests.lasers import beams_of_laser

WARM_UP, STEPS, EVERY = 200, 1000, 250


def held_by_processing():
    """Bytes that our own code allocated and keeps: the rest of a test run allocates meanwhile as well."""
    ours = [tracemalloc.Filter(True, "*/processing/*.py")]
    return sum(trace.size for trace in tracemalloc.take_snapshot().filter_traces(ours).traces)


def test_nothing_that_a_step_allocates_stays():
    laser = Urg04lx()
    beams = beams_of_laser(laser)
    drive = simulate_scans(room(), laser=laser, speed_mps=0.4, laps=20, max_scans=WARM_UP + STEPS)
    scans = [Scan(stamp_ns, ranges_m, beams) for stamp_ns, ranges_m, _ in drive]
    odometry, held, match = LaserOdometry(OdometryConfig(), 1), [], None
    tracemalloc.start()
    try:
        for scan in scans[:WARM_UP]:
            match = odometry.step(scan)
        for number, scan in enumerate(scans[WARM_UP:], 1):
            match = odometry.step(scan)
            if number % EVERY == 0:
                held.append(held_by_processing())
    finally:
        tracemalloc.stop()
    assert len(scans) == WARM_UP + STEPS
    assert match is not None
    # Key scans come and go, and are of all sizes up to 11 kB; there are twenty.
    assert max(held[1:]) - held[0] < 120_000
