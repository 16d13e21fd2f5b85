"""The map on its way out: whole when it grows, parts in between, tiles for whoever comes over a network."""

import time
from dataclasses import dataclass, field

import numpy as np
import pytest

from processing.occupancy import OccupancyGrid
from runtime import messages
from runtime.access.gate import BATCH_BYTES
from runtime.bus.contract import Mailbox
from runtime.bus.memory import MemoryBus
from runtime.bus.pulling import Puller
from runtime.clock import ManualClock
from runtime.nodes import map_teller
from runtime.nodes.map_teller import MapTeller
from runtime.nodes.viewing.scene import Scene
from runtime.port import ListPort, Received
from runtime.process.node import BusPort
from runtime.tiles import TILE

SECOND = 1_000_000_000


@dataclass
class Mapping:
    """Stands for the filter: a map and a path."""

    probability: np.ndarray = field(default_factory=lambda: np.full((40, 60), 0.5, np.float32))
    poses: int = 3

    def occupancy(self):
        return OccupancyGrid(self.probability, 0.05, (-0.5, 0.25))

    def trajectory(self, most):
        scans = np.arange(self.poses - 1, -1, -max(1, -(-self.poses // most)))[::-1]
        return scans + 1, np.zeros((len(scans), 3)) + scans[:, None]


@pytest.fixture
def port():
    return ListPort(clock=ManualClock(100 * SECOND))


@pytest.fixture
def teller(port):
    return MapTeller(port, 1.0)


def tell(teller, port, mapping, *, after_s=1.0, changed=True):
    port.clock.advance(round(after_s * SECOND))
    teller.changed |= changed
    port.published.clear()
    teller.tell(mapping, 5)
    return port


def test_the_first_map_is_whole_and_says_where_it_lies(teller, port):
    (whole,) = tell(teller, port, Mapping()).said("map")
    assert (whole.info.width, whole.info.height) == (2 * TILE, TILE)
    assert (whole.info.origin.position.x, whole.info.origin.position.y) == (-TILE * 0.05, 0.0)
    cells = whole.data.reshape(TILE, 2 * TILE)
    assert (cells[5:45, 54:114] == 50).all()
    assert np.count_nonzero(cells != -1) == 40 * 60
    assert not port.said("map_updates")


def test_in_between_goes_what_has_changed_and_a_viewer_has_the_same_map(teller, port):
    grids = []
    scene = Scene("robot", lambda kind, draw: grids.append(draw) if kind == "map" else None)
    mapping = Mapping()
    whole = tell(teller, port, mapping).said("map")[0]
    scene.take(Received("map", messages.decode(messages.encode(whole), "nav_msgs/msg/OccupancyGrid")))
    mapping.probability[3, 4] = 0.91
    updates = tell(teller, port, mapping).said("map_updates")
    assert not port.said("map")
    assert [(u.x, u.y, u.width, u.height) for u in updates] == [(0, 0, TILE, TILE)]
    for update in updates:
        wire = messages.encode(update)
        scene.take(Received("map_updates", messages.decode(wire, "map_msgs/msg/OccupancyGridUpdate")))
    assert scene.refused == 0
    scene.again()
    shown = []

    class Canvas:
        def at(self, stamp_ns):
            pass

        def grid(self, cells, resolution_m, origin_m):
            shown.append(cells)

    grids[-1](Canvas())
    assert shown[0][5 + 3, 54 + 4] == 91


def test_the_whole_map_comes_again_after_ten_seconds_even_when_the_robot_stands_still(teller, port):
    mapping = Mapping()
    tell(teller, port, mapping)
    mapping.probability[0, 0] = 0.0
    tell(teller, port, mapping)
    assert not tell(teller, port, mapping, after_s=4, changed=False).said("map")
    assert len(tell(teller, port, mapping, after_s=5, changed=False).said("map")) == 1
    assert not tell(teller, port, mapping, after_s=60, changed=False).said("map")


def test_a_map_that_grows_is_published_whole_at_once(teller, port):
    mapping = Mapping()
    tell(teller, port, mapping)
    mapping.probability = np.full((40, 200), 0.5, np.float32)
    assert [m.info.width for m in tell(teller, port, mapping).said("map")] == [4 * TILE]


def test_the_path_stays_under_the_size_that_a_slow_link_takes_and_keeps_the_newest_pose(teller, port):
    (path,) = tell(teller, port, Mapping(poses=2 * map_teller.PATH_POSES + 1)).said("trajectory")
    assert map_teller.PATH_POSES / 2 < len(path.poses) <= map_teller.PATH_POSES
    assert path.poses[-1].pose.position.x == 2 * map_teller.PATH_POSES
    assert len(messages.encode(path)) < 2 * BATCH_BYTES


def test_the_path_comes_every_five_seconds_while_the_map_changes_and_once_more_after_that(teller, port):
    mapping = Mapping()
    told = [len(tell(teller, port, mapping).said("trajectory")) for _ in range(11)]
    assert told == [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]
    tell(teller, port, mapping)
    told = [len(tell(teller, port, mapping, changed=False).said("trajectory")) for _ in range(10)]
    assert told == [0, 0, 0, 1, 0, 0, 0, 0, 0, 0]


def wait_for(mailbox):
    found = None
    end = time.monotonic() + 10
    while found is None:
        assert time.monotonic() < end, "no map came"
        found = mailbox.take(0.05)
    return messages.decode(bytes(found.payload), "nav_msgs/msg/OccupancyGrid"), found.attachment


def test_a_guest_asks_for_tiles_and_gets_the_topic_map(teller, port):
    mapping = Mapping(np.random.default_rng(1).random((300, 300)).astype(np.float32))
    whole = tell(teller, port, mapping).said("map")[0]
    with MemoryBus() as bus:
        bus.answer("hallway/robot/map", port.answers["map"])
        with BusPort("view_1", bus.join, subscribes=("map", "map_updates"), guest=True) as guest:
            maps, updates = guest.subscribe("map"), guest.subscribe("map_updates")
            guest.ready()
            end = time.monotonic() + 20
            received = None
            while received is None or not np.array_equal(received.message.data, whole.data):
                assert time.monotonic() < end, "the map did not become whole"
                received = maps.wait(0.1) or received
            assert received.published_ns == port.clock.now_ns()
            assert received.message.info.origin == whole.info.origin
            assert updates.received == 0
            pattern = "@ros2_lv/**"
            assert not [token for token in bus.tokens(pattern) if "%map" in token]


def test_a_guest_is_told_of_changes_by_the_second_and_of_nothing_else(teller, port):
    mapping = Mapping()
    tell(teller, port, mapping)
    asked = []
    mailbox = Mailbox(16)
    with MemoryBus() as bus:
        bus.answer("hallway/robot/map", lambda q: asked.append(q) or port.answers["map"](q))
        puller = Puller(bus.join(), "robot", "0/robot/map", mailbox.put)
        try:
            first, attachment = wait_for(mailbox)
            assert attachment.sequence == 1
            mapping.probability[3, 4] = 0.91
            tell(teller, port, mapping)
            second, attachment = wait_for(mailbox)
            assert attachment.sequence == 2
            assert np.count_nonzero(first.data != second.data) == 1
            assert mailbox.received == 2
            assert len(asked) < 10
        finally:
            puller.close()


def test_a_guest_asks_on_while_nobody_answers_and_survives_a_damaged_answer(teller, port):
    tell(teller, port, Mapping())
    answers = iter([b"", b"nonsense"])
    mailbox = Mailbox(16)
    with MemoryBus() as bus:
        puller = Puller(bus.join(), "robot", "0/robot/map", mailbox.put)
        try:
            bus.answer("hallway/robot/map", lambda q: next(answers, None) or port.answers["map"](q))
            assert wait_for(mailbox)[0].info.width == 2 * TILE
        finally:
            puller.close()
