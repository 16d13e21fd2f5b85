"""A drive of which scans never came: as it was driven, played back, and in one process, the same bytes."""

import threading
import time
from contextlib import contextmanager

import numpy as np
import pytest

from drivers.world import Urg04lx, pillar_hall, simulate_scans
from processing.odometry import Tracking
from processing.scan import Scan
from processing.slam import Slam
from runtime.bus.inbox import Inbox
from runtime.bus.memory import MemoryBus
from runtime.clock import Clock
from runtime.formats.logs import open_log
from runtime.formats.mcap_log import McapChannel
from runtime.formats.mcap_writer import McapWriter
from runtime.formats.write_bags import scan_messages, write_mcap
from runtime.formats.write_text import write_carmen
from runtime.messages import Attachment, encode, topic_key
from runtime.nodes import matcher, player
from runtime.nodes.convert import motion_to_message, scan_to_message
from runtime.nodes.log_scans import counted
from runtime.process.node import BusPort
from runtime.recordings.replay import ReplayConfig
from runtime.topics import ALL, topic
from tests.lasers import beams_of_laser

LASER = Urg04lx()
BEAMS = beams_of_laser(LASER)
SCANS, HOLE = 80, range(50, 60)
"""Ten scans are missing while the robot drives."""


@pytest.fixture(scope="module")
def drive():
    course = simulate_scans(pillar_hall(9.0, 7.0), laser=LASER, speed_mps=0.6, max_scans=SCANS, seed=3)
    return [Scan(stamp_ns, ranges_m.copy(), BEAMS) for stamp_ns, ranges_m, _ in course]


class LossyBus(MemoryBus):
    """Takes what this session publishes, and delivers nothing whose number is in the hole."""

    def publisher(self, key, **kwargs):
        publisher = super().publisher(key, **kwargs)
        if f"/{topic('scan').name}/" in key:
            deliver = publisher.put

            def put(payload, attachment):
                if Attachment.decode(attachment).sequence - 1 not in HOLE:
                    deliver(payload, attachment)

            publisher.put = put
        return publisher


class Stage:
    """A matcher on a bus in memory, and what was heard on that bus."""

    def __init__(self, folder):
        folder.mkdir()
        self.bus, self._folder = LossyBus(), folder
        self.scans, self.odom = (self._listen(name) for name in ("scan", "odom"))
        self._port = BusPort(
            "matcher",
            self.bus.join,
            subscribes=matcher.SUBSCRIBES,
            publishes=matcher.PUBLISHES,
            run_dir=folder,
        )
        self._matcher = threading.Thread(target=matcher.run, args=(self._port, matcher.Config()))

    def _listen(self, name):
        row = topic(name)
        inbox = Inbox(row, Clock(), lambda: False, keep=ALL, raw=True)
        self.bus.subscribe(topic_key(f"robot/{name}", row.type), inbox.mailbox.put)
        return inbox

    @contextmanager
    def running(self):
        self._matcher.start()
        while not self._port._is_ready:
            time.sleep(0.01)
        yield self
        self._port.stop()
        self._matcher.join()
        self._port.close()

    def answered(self):
        """Wait until every scan that came has its motion, so that none gives way to the next."""
        end = time.monotonic() + 20.0
        while self.odom.received < self.scans.received:
            assert time.monotonic() < end
            time.sleep(0.001)

    def motions(self):
        return [received.payload for received in self.odom.drain()]


@pytest.fixture(params=["a hole", "a laser process that was started again"])
def driven(request, drive, tmp_path):
    """(motions, recording) of the drive itself."""
    restarted = request.param != "a hole"
    with Stage(tmp_path / "driven").running() as stage:
        laser = BusPort("laser", lambda: stage.bus, publishes=["scan"], run_dir=tmp_path)
        for number, scan in enumerate(drive):
            if restarted and number == HOLE.start:
                laser = BusPort("laser", stage.bus.join, publishes=["scan"], run_dir=tmp_path)
            if not (restarted and number in HOLE):
                laser.publish("scan", scan_to_message(scan))
            stage.answered()
        writer = McapWriter(tmp_path / "run.mcap")
        for one in stage.scans.drain():
            channel = McapChannel("/robot/scan", topic("scan").type, {"gid": one.gid.hex()})
            writer.add(channel, one.sequence, one.received_ns, one.published_ns, one.payload)
        writer.finish()
        return stage.motions(), tmp_path / "run.mcap"


def played(recording, tmp_path):
    class Patient(BusPort):
        def publish_raw(self, name, *args):
            super().publish_raw(name, *args)
            stage.answered()

    with Stage(tmp_path / "played").running() as stage:
        # Its own session loses nothing: the hole is in the recording already.
        port = Patient("player", stage.bus.join, subscribes=player.SUBSCRIBES, publishes=player.PUBLISHES)
        assert (
            player.run(
                port, player.Config(file=str(recording), replay=ReplayConfig(rate=0.0, topics=("scan",)))
            )
            == 0
        )
        return stage.motions()


def offline(recording, counts=True):
    slam = Slam()
    steps = [slam.step(scan, missed if counts else 0) for scan, missed in counted(open_log(recording))]
    return steps, [encode(motion_to_message(step.match.motion)) for step in steps]


def test_a_drive_with_a_hole_is_the_same_however_it_is_taken(driven, tmp_path, monkeypatch):
    monkeypatch.setattr(player, "PATIENCE_S", 0.0)  # nobody maps
    monkeypatch.setattr(player, "LEAD_S", 0.0)
    motions, recording = driven
    assert len(motions) == SCANS - len(HOLE)
    steps, alone = offline(recording)
    assert alone == motions
    assert played(recording, tmp_path) == motions
    assert all(step.match.state is not Tracking.LOST for step in steps)


def test_a_text_log_with_a_hole_is_the_same_as_it_is_and_converted_and_played(drive, tmp_path, monkeypatch):
    monkeypatch.setattr(player, "PATIENCE_S", 0.0)
    monkeypatch.setattr(player, "LEAD_S", 0.0)
    writer = McapWriter(tmp_path / "drive.mcap")
    for number, scan in enumerate(drive):
        if number not in range(12, 22):  # early: the rate is told by the stamps, of which most tell no hole
            message = encode(scan_to_message(scan))
            writer.add(McapChannel("/robot/scan", topic("scan").type), 0, scan.stamp_ns, 0, message)
    writer.finish()
    write_carmen(tmp_path / "drive.clf", open_log(tmp_path / "drive.mcap"))
    text = open_log(tmp_path / "drive.clf")
    write_mcap(tmp_path / "converted.mcap", scan_messages(text))
    _, motions = offline(tmp_path / "drive.clf")
    assert motions != offline(tmp_path / "drive.clf", counts=False)[1]
    assert offline(tmp_path / "converted.mcap")[1] == motions
    assert played(tmp_path / "converted.mcap", tmp_path) == motions


def test_without_the_count_the_hole_would_be_a_leap(driven):
    motions, recording = driven
    steps, alone = offline(recording, counts=False)
    assert alone[: HOLE.start] == motions[: HOLE.start]
    assert alone[HOLE.start] != motions[HOLE.start]
    assert steps[HOLE.start].match.motion.lost


def test_a_log_without_numbers_tells_its_hole_by_the_stamps(drive, tmp_path):
    writer = McapWriter(tmp_path / "run.mcap")
    kept = [scan for number, scan in enumerate(drive[:65]) if number not in HOLE]
    for scan in kept:
        writer.add(
            McapChannel("/scan", topic("scan").type), 0, scan.stamp_ns, 0, encode(scan_to_message(scan))
        )
    writer.finish()
    read = list(counted(open_log(tmp_path / "run.mcap")))
    assert {number: missed for number, (_, missed) in enumerate(read) if missed} == {HOLE.start: len(HOLE)}
    np.testing.assert_array_equal(read[-1][0].ranges_m, kept[-1].ranges_m)
