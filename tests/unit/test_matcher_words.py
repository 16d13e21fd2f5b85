"""What the matcher process says of itself: the state, and where something is wrong what to do."""

from drivers.world import Urg04lx, corridor, room, simulate_scans
from processing.odometry import LaserOdometry, OdometryConfig
from processing.scan import Scan
from runtime.nodes.matcher import publish
from runtime.port import ListPort
from tests.lasers import beams_of_laser

LASER = Urg04lx()


def told(building):
    """Return level, text and state of the matcher after two seconds in a building."""
    port, odometry = ListPort(), LaserOdometry(OdometryConfig(), 1)
    for stamp_ns, ranges_m, _ in simulate_scans(building, laser=LASER, max_scans=20, rest_s=0.0):
        publish(port, odometry.step(Scan(stamp_ns, ranges_m.copy(), beams_of_laser(LASER))))
    level, text, values = port.reports[-1]
    return level, text, values["state"]


def test_a_room_is_tracked():
    assert told(room()) == ("ok", "tracking", "TRACKING")


def test_a_bare_corridor_is_told_with_its_direction_and_what_to_do():
    level, text, state = told(corridor(40.0))
    assert level == "warn"
    assert "one direction is not seen" in text
    assert "keep your speed" in text
    assert state == "DEGENERATE (0 deg)"
