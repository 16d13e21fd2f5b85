"""What a process takes is told of itself and of another, and of one that has ended nothing is told."""

import os
import subprocess
import sys
import time

from runtime.process.usage import Usage


def test_a_process_that_works_is_seen_to_work_from_outside():
    with subprocess.Popen([sys.executable, "-c", "while True: pass"]) as busy:
        usage = Usage(busy.pid)
        end = time.monotonic() + 30
        while float(usage.values()["cpu_percent"]) == 0.0:
            assert time.monotonic() < end
            time.sleep(0.05)
        values = {name: float(value) for name, value in usage.values().items()}
        busy.kill()
    assert values["rss_mb"] > 1
    assert values["cpu_s"] > 0
    assert 0 < values["cpu_percent"] < 110
    assert usage.values() == {}


def test_this_process_is_the_one_that_is_meant_without_a_number():
    mine, same = Usage().values(), Usage(os.getpid()).values()
    assert float(mine["rss_mb"]) > 1
    assert abs(float(mine["cpu_s"]) - float(same["cpu_s"])) < 1.0
