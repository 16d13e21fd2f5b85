"""What the topics carry is, to the last bit, what the cores computed with."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from processing import se2
from processing.motion import Motion
from processing.scan import Beams, Scan
from runtime import messages
from runtime.nodes import convert

metres = st.floats(-1e4, 1e4)
stamps_ns = st.integers(0, 2**31 * 10**9 - 1)
any_range = st.floats(0, 60, width=32) | st.sampled_from((float("nan"), float("inf")))


@st.composite
def scans(draw):
    ranges = draw(hnp.arrays(np.float32, st.integers(1, 700), elements=any_range))
    beams = Beams(
        count=len(ranges),
        angle_min_rad=draw(st.floats(-7, 7)),
        angle_increment_rad=draw(st.floats(-0.1, 0.1)),
        time_increment_s=draw(st.floats(0, 0.01)),
        period_s=draw(st.floats(0.01, 1)),
        range_min_m=draw(st.floats(0, 1)),
        range_max_m=draw(st.floats(2, 100)),
    )
    return Scan(draw(stamps_ns), ranges, beams)


@given(scans())
def test_a_scan_comes_back_bit_for_bit(scan):
    payload = messages.encode(convert.scan_to_message(scan))
    back = convert.scan_from_message(messages.decode(payload, "sensor_msgs/msg/LaserScan"))
    assert back.stamp_ns == scan.stamp_ns
    assert back.beams == scan.beams
    assert back.ranges_m.tobytes() == scan.ranges_m.tobytes()
    assert back.ranges_m.flags.writeable


@settings(max_examples=500)
@given(
    stamps_ns,
    st.tuples(metres, metres, st.floats(-np.pi, np.pi) | st.sampled_from((np.pi, -np.pi, 0.0, -0.0))),
    hnp.arrays(np.float64, (3, 3), elements=st.floats(-1e6, 1e6)),
    hnp.arrays(np.float64, 3, elements=st.floats(-10, 10)),
)
def test_a_motion_comes_back_bit_for_bit(stamp_ns, pose, covariance, twist):
    motion = Motion(stamp_ns, se2.snap_yaw(np.array(pose)), covariance, twist)
    payload = messages.encode(convert.motion_to_message(motion))
    back = convert.motion_from_message(messages.decode(payload, "nav_msgs/msg/Odometry"))
    assert back.stamp_ns == stamp_ns
    assert back.odom_t_laser.tolist() == motion.odom_t_laser.tolist()
    assert back.covariance.tobytes() == covariance.tobytes()
    assert back.twist.tobytes() == twist.tobytes()


def test_an_impossible_scanner_is_a_bad_message():
    beams = Beams(count=3, angle_min_rad=0, angle_increment_rad=1)
    message = convert.scan_to_message(Scan(0, np.ones(3, np.float32), beams))
    message.range_max = 0.0
    with pytest.raises(messages.BadMessageError, match="ranges"):
        convert.scan_from_message(message)
