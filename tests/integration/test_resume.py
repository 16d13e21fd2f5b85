"""Matcher and mapper, killed in mid-way, go on in the same frame and with the same map."""

import numpy as np
import pytest

from drivers import world
from processing.odometry import OdometryConfig
from processing.scan import Beams, Scan
from runtime import messages
from runtime.clock import Clock
from runtime.nodes import mapper, matcher
from runtime.nodes.convert import (
    motion_from_message,
    motion_to_message,
    pose_from_message,
    scan_to_message,
)
from runtime.port import ListPort

PERIOD_NS = 100_000_000
SPEED_M_S = 0.3


def scans():
    """Five seconds straight through a room, without noise; the laser starts at the origin of `odom`."""
    building = world.room()
    start = np.asarray(building.start, dtype=np.float64)
    beams = Beams(count=682, angle_min_rad=-2.0862, angle_increment_rad=2 * np.pi / 1024, range_max_m=5.6)
    for number in range(50):
        way = SPEED_M_S * number * PERIOD_NS / 1e9
        origin = start[:2] + way * np.array((np.cos(start[2]), np.sin(start[2])))
        hits = world.cast(building, origin, beams.bearings() + start[2])
        ranges = np.asarray(hits.ranges_m, dtype=np.float32).reshape(-1)
        yield scan_to_message(Scan(1_000_000_000 + number * PERIOD_NS, ranges, beams))


def drive(messages, run_dir, config=None, after=0):
    inputs = [("scan", message) for message in messages]
    port = ListPort(*inputs, run_dir=run_dir, sequences={"scan": after})
    assert matcher.run(port, config or matcher.Config()) == 0
    return port, [motion_from_message(message) for message in port.said("odom")]


@pytest.fixture(scope="module", name="drive_scans")
def fixture_drive_scans():
    return list(scans())


def test_it_goes_on_where_the_process_before_it_was_killed(drive_scans, tmp_path):
    drive(drive_scans[:24], tmp_path)
    port, motions = drive(drive_scans[32:], tmp_path, after=32)
    assert port.counters["resumptions"] == 1
    for motion in motions:
        way = SPEED_M_S * (motion.stamp_ns - 1_000_000_000) / 1e9
        assert motion.odom_t_laser[:2] == pytest.approx((way, 0.0), abs=0.05)
        assert not motion.lost


def test_without_a_checkpoint_it_begins_at_the_origin(drive_scans, tmp_path):
    port, motions = drive(drive_scans[32:36], tmp_path)
    assert "resumptions" not in port.counters
    assert motions[0].odom_t_laser.tolist() == [0.0, 0.0, 0.0]


def test_the_checkpoint_of_another_configuration_is_not_taken(drive_scans, tmp_path):
    drive(drive_scans[:24], tmp_path)
    other = matcher.Config(odometry=OdometryConfig(key_distance_m=0.7))
    port, _ = drive(drive_scans[32:36], tmp_path, other)
    assert "resumptions" not in port.counters


@pytest.mark.parametrize("after", [19, 0])
def test_scans_that_never_came_are_no_leap(drive_scans, tmp_path, after):
    """Whether the laser counts on (19) or was started anew itself (0): ten periods are not taken for one."""
    drive(drive_scans[:10], tmp_path)
    port, _ = drive(drive_scans[19:], tmp_path, after=after)
    speeds = [motion_from_message(message).twist[0] for message in port.said("odom")]
    assert speeds[2:] == pytest.approx([SPEED_M_S] * len(speeds[2:]), abs=0.1)


class Paced(ListPort):
    """Gives one motion at a time, as a matcher does."""

    def subscribe(self, topic, **how):
        subscription = super().subscribe(topic, **how)
        if topic == "odom":
            subscription.drain = list
        return subscription


def test_a_mapper_goes_on_with_its_map(drive_scans, tmp_path):
    _, motions = drive(drive_scans, tmp_path / "matcher")
    both = list(zip(drive_scans, motions, strict=True))

    def run(pairs):
        inputs = [
            pair for scan, motion in pairs for pair in (("scan", scan), ("odom", motion_to_message(motion)))
        ]
        port = Paced(*inputs, run_dir=tmp_path, clock=Clock())
        assert mapper.run(port, mapper.Config()) == 0
        return port, [pose_from_message(message.pose.pose) for message in port.said("pose")]

    first, _ = run(both[:25])
    second, poses = run(both[30:])
    assert "resumptions" not in first.counters
    assert second.counters["resumptions"] == 1
    for (_, motion), pose in zip(both[30:], poses, strict=True):
        assert pose[:2] == pytest.approx(motion.odom_t_laser[:2], abs=0.05)
    # What the maps hold is said with every pose: the soak takes it off what the process holds.
    held_mb = [values["map_mb"] for _, text, values in first.reports if text == "mapping"]
    assert len(held_mb) == len(first.said("pose"))
    assert held_mb[-1] > 0.0
    # What only the first one saw is still in the map of the second.
    trajectory = second.said("trajectory")[-1]
    assert messages.stamp_ns_of(trajectory.poses[0].header.stamp) == motions[0].stamp_ns
