"""The monitor tells how late poses are now, and writes down how late they were."""

import json

import numpy as np
import pytest

from runtime import messages
from runtime.clock import ManualClock
from runtime.nodes import monitor
from runtime.nodes.convert import pose_to_message
from runtime.port import ListPort

MS = 1_000_000
PERIOD_MS = 100


class Drive(ListPort):
    """A robot in a time of its own: ten scans a second, each with its pose after a delay.

    Args:
        delays_ms: From the first ray to the pose, of one scan after the other.
        scan_ms: From the first ray to the scan, of each of them, if not as long as a turn takes.
        odom_ms: From the first ray to the odometry, of each of them, if there is any.
    """

    def __init__(self, delays_ms, results_dir=None, scan_ms=(), odom_ms=()):
        super().__init__(clock=ManualClock(), results_dir=results_dir)
        self._now_ms, self._count = 0, len(delays_ms)
        made_ms = {"scan": scan_ms or [PERIOD_MS] * self._count, "odom": odom_ms, "pose": delays_ms}
        self._plan = [
            (number * PERIOD_MS + after_ms, topic, number * PERIOD_MS * MS)
            for topic, each_ms in made_ms.items()
            for number, after_ms in enumerate(each_ms)
        ]
        self._plan.sort()

    @property
    def stopping(self):
        self.clock.advance(10 * MS)
        self._now_ms += 10
        while self._plan and self._plan[0][0] <= self._now_ms:
            _, topic, stamp_ns = self._plan.pop(0)
            self.inputs.setdefault(topic, []).append(MAKE[topic](messages.header(stamp_ns, "laser")))
        return self._now_ms > (self._count + 20) * PERIOD_MS


def scan(header):
    nothing = np.zeros(0, np.float32)
    return messages.LaserScan(header, 0.0, 1.0, 0.1, 0.0, 0.1, 0.0, 9.0, nothing, nothing)


def pose(header):
    placed = messages.PoseWithCovariance(pose_to_message(np.zeros(3)), np.zeros(36))
    return messages.PoseWithCovarianceStamped(header, placed)


def odom(header):
    placed = messages.PoseWithCovariance(pose_to_message(np.zeros(3)), np.zeros(36))
    still = messages.Twist(messages.Vector3(0.0, 0.0, 0.0), messages.Vector3(0.0, 0.0, 0.0))
    return messages.Odometry(header, "laser", placed, messages.TwistWithCovariance(still, np.zeros(36)))


MAKE = {"scan": scan, "odom": odom, "pose": pose}


def test_a_slow_start_is_told_for_a_minute_and_written_down_for_good(tmp_path):
    port = Drive([600] * 16 + [500, 400, 300, 200] + [120] * 700, tmp_path)
    assert monitor.run(port, monitor.Config()) == 0
    levels = [level for level, _, _ in port.reports]
    assert levels[3:50] == ["warn"] * 47
    assert set(levels[65:]) == {"ok"}
    text, values = next((text, values) for level, text, values in port.reports if level == "warn")
    assert text.startswith("poses are late: p99 600 ms, limit 200 ms; ")
    assert port.reports[-1][1] == "used 720 of 720 scans"
    assert values["latency.whole.p99_ms"] == "600.00"
    assert port.reports[-1][2]["latency.whole.max_ms"] == "120.00"
    kept = json.loads((tmp_path / "latency.json").read_text())
    assert kept["hops"]["whole"]["max"] == 600.0
    assert kept["hops"]["whole"]["count"] == kept["mapped"] == 720


@pytest.mark.parametrize(
    ("slow", "hop"),
    [
        ({"scan_ms": [100] * 90 + [390] * 10, "odom_ms": [100] * 90 + [395] * 10}, "scan"),
        ({"scan_ms": [100] * 100, "odom_ms": [105] * 90 + [395] * 10}, "match"),
        ({"scan_ms": [100] * 100, "odom_ms": [110] * 100}, "map"),
    ],
)
def test_a_late_pose_is_told_with_what_made_it_late_and_what_helps(slow, hop):
    port = Drive([120] * 90 + [400] * 10, **slow)
    assert monitor.run(port, monitor.Config()) == 0
    late = [text for level, text, _ in port.reports if level == "warn"]
    assert late[-1] == f"poses are late: p99 400 ms, limit 200 ms; {monitor.REASONS[hop]}"
