"""What the matcher process says of itself: the state, and where something is wrong what to do."""

import dataclasses

from drivers.world import Urg04lx, corridor, room, simulate_scans
from processing.odometry import LaserOdometry, OdometryConfig
from processing.scan import Scan
from runtime.nodes.matcher import BLIND_NS, Teller
from runtime.port import ListPort
from tests.lasers import beams_of_laser

LASER = Urg04lx()


def reports(*buildings):
    """Return stamp, level, text and state of each scan of two seconds in buildings, one after the other."""
    port, odometry = ListPort(), LaserOdometry(OdometryConfig(), 1)
    teller, stamps_ns = Teller(port), []
    for building in buildings:
        for _, ranges_m, _ in simulate_scans(building, laser=LASER, max_scans=20, rest_s=0.0):
            stamps_ns.append(1_000_000_000 + 99_889_000 * len(stamps_ns))
            teller.tell(odometry.step(Scan(stamps_ns[-1], ranges_m.copy(), beams_of_laser(LASER))))
    return [
        (stamp_ns, level, text, values["state"])
        for stamp_ns, (level, text, values) in zip(stamps_ns, port.reports, strict=True)
    ]


def told(building):
    """Return the last of them."""
    return reports(building)[-1][1:]


def test_a_room_is_tracked():
    assert told(room()) == ("ok", "tracking", "TRACKING")


def test_a_bare_corridor_is_told_with_its_direction_and_what_to_do():
    level, text, state = told(corridor(40.0))
    assert level == "warn"
    assert "one direction is not seen" in text
    assert "keep your speed" in text
    assert state == "DEGENERATE (0 deg)"


def test_the_state_is_told_at_once_and_the_warning_when_it_stays():
    told = reports(corridor(40.0))
    blind = [report for report in told if report[3].startswith("DEGENERATE")]
    since_ns = blind[0][0]
    assert len(blind) > 10
    for stamp_ns, level, text, _ in blind:
        assert (level == "warn") == (stamp_ns - since_ns >= BLIND_NS)
        assert "one direction is not seen" in text


def test_a_view_in_between_begins_the_time_anew():
    matches = []
    for building in (corridor(40.0), room()):
        odometry = LaserOdometry(OdometryConfig(), 1)
        for stamp_ns, ranges_m, _ in simulate_scans(building, laser=LASER, max_scans=20, rest_s=0.0):
            matches.append(odometry.step(Scan(stamp_ns, ranges_m.copy(), beams_of_laser(LASER))))
    blind, sees = matches[19], matches[39]
    port = ListPort()
    teller = Teller(port)
    for k, match in enumerate((blind, sees, blind, blind, blind)):
        motion = dataclasses.replace(match.motion, stamp_ns=k * 2 * BLIND_NS // 3)
        teller.tell(dataclasses.replace(match, motion=motion))
    assert [level for level, *_ in port.reports] == ["ok", "ok", "ok", "ok", "warn"]
