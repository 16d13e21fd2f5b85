"""What the mapper process says, and keeps back, while nobody knows where the laser is."""

from dataclasses import replace

import numpy as np

from drivers.world import Urg04lx, room, simulate_scans
from processing.dpslam.config import DpSlamConfig
from processing.dpslam.filter import DpSlam
from processing.motion import anew_covariance, lost_covariance
from processing.odometry import LaserOdometry, OdometryConfig
from processing.scan import Scan
from runtime.nodes.mapper import Config, _lost, _Mapper
from runtime.port import ListPort
from tests.lasers import beams_of_laser

LASER = Urg04lx()
BEAMS = beams_of_laser(LASER)


def test_a_lost_laser_is_told_in_words_and_no_pose_goes_out_until_it_is_found():
    port, odometry = ListPort(), LaserOdometry(OdometryConfig(), 1)
    mapper = _Mapper(port, Config(mapping=DpSlamConfig(particles=5)))
    said = []
    course = simulate_scans(room(), laser=LASER, speed_mps=0.5, max_scans=170, rest_s=0.0, seed=1)
    for number, (stamp_ns, ranges_m, _) in enumerate(course):
        scan = Scan(stamp_ns, ranges_m.copy(), BEAMS)
        motion = odometry.step(scan).motion
        if 100 <= number < 104:
            motion = replace(motion, covariance=lost_covariance())
        elif number == 104:
            motion = replace(motion, covariance=anew_covariance())
        before = len(port.published)
        mapper.take(scan, motion)
        level, text, _ = port.reports[-1]
        said.append((level, text, any(topic == "pose" for topic, _ in port.published[before:])))
    assert all(word == ("ok", "mapping", True) for word in said[:100])
    waits = said[100:104]
    assert {(level, pose) for level, _, pose in waits} == {("warn", False)}
    assert "the map waits" in waits[0][1]
    searches = [word for word in said[104:] if word[0] == "error"]
    assert all("looking for the laser" in text or "fit equally" in text for _, text, _ in searches)
    assert not any(pose for _, _, pose in searches)
    assert said[-1] == ("ok", "mapping", True)


def test_places_that_fit_equally_are_named_with_what_to_do():
    odometry, filter_ = LaserOdometry(OdometryConfig(), 1), DpSlam(DpSlamConfig(particles=2))
    stamp_ns, ranges_m, _ = next(simulate_scans(room(), laser=LASER, max_scans=1))
    scan = Scan(stamp_ns, ranges_m.copy(), BEAMS)
    motion = odometry.step(scan).motion
    places = (np.array((1.0, 2.0, 0.0)), np.array((5.0, 2.0, np.pi)))
    step = replace(filter_.step(scan, motion), lost=True, places=places)
    level, text = _lost(step, motion)
    assert level == "error"
    assert "2 places of the map fit equally: (1.00 m, 2.00 m, 0 deg) and (5.00 m, 2.00 m, 180 deg)" in text
    assert "drive on" in text
