"""Frames as REP-105 asks: map, odom, base_link, laser, each with one parent, where the mounting is known."""

import numpy as np
import pytest

from processing import se2
from runtime import messages
from runtime.nodes import matcher, mounting
from runtime.nodes.convert import pose_from_message, scan_to_message
from runtime.nodes.offline_config import OfflineConfig
from runtime.port import ListPort

MOUNTED = (0.12, -0.03, 0.5)


def frames(message):
    return [(one.header.frame_id, one.child_frame_id) for one in message.transforms]


def pose_of(message):
    transform = message.transforms[0].transform
    return pose_from_message(messages.Pose(transform.translation, transform.rotation))


def run(config, folder, count=3):
    """The matcher on scans of a small room; its messages by topic."""
    scans = [("scan", scan_to_message(scan)) for scan in matcher.rehearsal(count)]
    port = ListPort(*scans, run_dir=folder, results_dir=folder)
    assert matcher.run(port, config) == 0
    return {name: [sent for topic, sent in port.published if topic == name] for name in matcher.PUBLISHES}


def test_without_a_mounting_odom_leads_to_the_laser(tmp_path):
    said = run(matcher.Config(), tmp_path)
    assert said["tf_static"] == []
    assert [frames(one) for one in said["tf"]] == [[("odom", "laser")]] * 3


def test_with_a_mounting_the_chain_goes_through_base_link_to_the_same_laser(tmp_path):
    said = run(matcher.Config(laser_in_base=MOUNTED), tmp_path)
    (mounted,) = said["tf_static"]
    assert frames(mounted) == [("base_link", "laser")]
    assert [frames(one) for one in said["tf"]] == [[("odom", "base_link")]] * 3
    for robot, motion in zip(said["tf"], said["odom"], strict=True):
        assert motion.child_frame_id == "laser"
        laser = se2.compose(pose_of(robot), pose_of(mounted))
        assert laser == pytest.approx(pose_from_message(motion.pose.pose), abs=1e-9)
    assert np.hypot(*pose_of(said["tf"][0])[:2]) == pytest.approx(np.hypot(*MOUNTED[:2]))


def test_who_comes_late_and_asks_for_nothing_hears_of_the_mounting_within_a_second(tmp_path):
    said = run(matcher.Config(laser_in_base=MOUNTED), tmp_path, count=25)
    stamps = [one.transforms[0].header.stamp for one in said["tf_static"]]
    assert np.diff([stamp.sec + 1e-9 * stamp.nanosec for stamp in stamps]) == pytest.approx([1.0, 1.0])


@pytest.mark.parametrize("config", [matcher.Config, OfflineConfig])
def test_a_mounting_is_three_finite_numbers(config):
    with pytest.raises(ValueError, match=r"laser_in_base = .*, must be three finite numbers"):
        config(laser_in_base=(0.0, float("nan"), 0.0))


def test_the_robot_is_where_its_laser_says():
    assert mounting.of_base(np.array((2.0, 1.0, np.pi / 2)), (0.5, 0.0, 0.0)) == pytest.approx(
        (2.0, 0.5, np.pi / 2)
    )
