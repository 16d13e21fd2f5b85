"""The emulated sensor's manners on the line: pace, order, rates, and what a terminal does.

A busy machine reads late, never early: what has to be prompt is judged by the sensor's own stamps, or by the
promptest of several goes; what takes its time never takes less.
"""

import os
import time

import numpy as np
import pytest

from drivers.errors import TransportError
from drivers.transport import SerialStream
from drivers.urg04lx.decoder import Decoder, Reply, ScanReply
from drivers.urg04lx.emulator import PERIOD_NS, Emulator
from drivers.urg04lx.model import Mode
from drivers.urg04lx.protocol import StreamRequest, decode_value
from drivers.urg04lx.scene import still_room


class Host:
    """Reads everything that comes, with the time of its coming by the emulator's clock."""

    def __init__(self, emulator, request=None, baud=115_200):
        self.emulator = emulator
        self.stream = SerialStream(emulator.port, baud, 0.02)
        self.decoder = Decoder(request or StreamRequest())
        self.chunks = []

    def send(self, line):
        """Send a line; return the times before and after it."""
        before_ns = self.emulator.now_ns()
        self.stream.write(line + b"\n")
        return before_ns, self.emulator.now_ns()

    def collect(self, count, within_s=20.0):
        """Return `count` replies, as many as come in time."""
        replies, end = [], time.monotonic() + within_s
        while len(replies) < count and time.monotonic() < end:
            chunk = self.stream.read()
            if chunk:
                self.chunks.append((self.emulator.now_ns(), len(chunk)))
                replies += self.decoder.feed(chunk, self.emulator.now_ns())
        return replies


@pytest.fixture
def idle():
    with Emulator(mode=Mode.IDLE, speed=1.25) as emulator:
        host = Host(emulator)
        yield emulator, host
        host.stream.close()


def test_one_command_is_answered_in_a_revolution(idle):
    _, host = idle
    began_ns, _ = host.send(b"TM0")
    for _ in range(3):
        host.send(b"TM1")
    replies = host.collect(4)
    assert [reply.echo for reply in replies] == [b"TM0", b"TM1", b"TM1", b"TM1"]
    answered_ms = [decode_value(reply.lines[0][:4]) for reply in replies[1:]]
    assert np.diff(answered_ms) == pytest.approx([PERIOD_NS / 1e6] * 2, abs=4)
    assert replies[-1].at_ns - began_ns > 3 * PERIOD_NS - 3e6


def test_a_stream_is_acknowledged_and_its_scans_follow_with_every_revolution(idle):
    emulator, host = idle
    before_ns, after_ns = host.send(b"MD0044072501000")
    acknowledged, *scans = host.collect(6)
    assert acknowledged == Reply(acknowledged.at_ns, b"MD0044072501000", b"00")
    assert all(isinstance(scan, ScanReply) for scan in scans)
    first_ns = emulator.sweeps[0][1]
    assert scans[0].at_ns - before_ns > 190e6  # one revolution to start the laser, one to measure
    assert before_ns + 97e6 < first_ns < after_ns + 240e6
    steps = np.diff([scan.stamp_ms for scan in scans])
    assert set(steps) <= {99, 100}


def test_a_scan_comes_in_small_pieces_over_some_milliseconds(idle):
    _, host = idle
    host.send(b"MD0044072501000")
    host.collect(3)

    def pieces():
        host.chunks.clear()
        host.collect(1)
        return len(host.chunks) > 3 and host.chunks[-1][0] - host.chunks[0][0] > 2e6

    assert any(pieces() for _ in range(100))


def test_the_stop_is_answered_after_what_was_on_its_way(idle):
    emulator, host = idle
    host.send(b"MD0044072501000")
    _, *scans = host.collect(3)
    _, after_ns = host.send(b"QT")
    while isinstance((reply := host.collect(1)[0]), ScanReply):
        scans.append(reply)
    assert reply.echo == b"QT"
    assert host.collect(1, 0.4) == []
    assert [scan.stamp_ms for scan in scans] == [stamp_ms for stamp_ms, _ in emulator.sweeps]
    assert emulator.sweeps[-1][1] < after_ns


def test_every_third_scan_is_sent_if_two_are_left_out():
    request = StreamRequest(skip=2)
    with Emulator(mode=Mode.IDLE, speed=4.0) as emulator:
        host = Host(emulator, request)
        host.send(request.encode())
        _, *scans = host.collect(4)
        host.stream.close()
    assert np.diff([scan.stamp_ms for scan in scans]) == pytest.approx([300, 300], abs=1)


def test_a_finite_stream_ends_by_itself():
    request = StreamRequest(scans=3)
    with Emulator(mode=Mode.IDLE, speed=4.0) as emulator:
        host = Host(emulator, request)
        host.send(request.encode())
        replies = host.collect(4)
        assert host.collect(1, 0.3) == []
        host.stream.close()
    assert [reply.remaining for reply in replies[1:]] == [2, 1, 0]


def test_without_the_mirror_answers_come_at_once():
    with Emulator(mode=Mode.IDLE, fast=True, speed=0.25) as emulator:
        host = Host(emulator)
        began_ns = emulator.now_ns()
        for _ in range(20):
            host.send(b"QT")
            assert len(host.collect(1)) == 1
        host.stream.close()
        assert emulator.now_ns() - began_ns < 10 * PERIOD_NS


def test_on_rs_232_bytes_take_their_time():
    with Emulator(mode=Mode.IDLE, rs232=True, fast=True) as emulator:
        host = Host(emulator, baud=19_200)

        def late_s():
            """How much longer than on the line it took."""
            host.chunks.clear()
            began_ns, _ = host.send(b"PP")
            host.collect(1)
            size = sum(count for _, count in host.chunks)
            assert size > 100
            return (host.chunks[-1][0] - began_ns) / 1e9 - (size - 64) * 10 / 19_200

        lates_s = [late_s()]
        while lates_s[-1] > 0.04 and len(lates_s) < 100:
            lates_s.append(late_s())
        host.stream.close()
    assert min(lates_s) >= 0.0
    assert lates_s[-1] < 0.04


def test_a_line_too_slow_for_every_scan_drops_whole_scans():
    request = StreamRequest()
    with Emulator(mode=Mode.IDLE, rs232=True, speed=4.0) as emulator:
        host = Host(emulator, baud=19_200)
        host.send(request.encode())
        _, *scans = host.collect(4)
        host.stream.close()
        assert emulator.dropped > 10
    assert np.diff([scan.stamp_ms for scan in scans]).min() > 1000
    assert host.decoder.damaged.total() == 0


def test_scans_that_nobody_reads_are_dropped_whole_when_the_terminal_is_full():
    with Emulator(mode=Mode.STREAMING, speed=20.0) as emulator:
        end = time.monotonic() + 10.0
        while not emulator.dropped and time.monotonic() < end:
            emulator.sleep(0.5)
        assert emulator.dropped > 0
        opened_ms = emulator.sweeps[-1][0]
        host = Host(emulator)
        scans = [reply for reply in host.collect(60) if isinstance(reply, ScanReply)]
        host.stream.close()
    assert scans[-1].stamp_ms > opened_ms
    assert host.decoder.damaged.total() <= 1  # the one that opening cut in two


def test_held_up_it_sends_late_what_it_has_seen_and_leaves_nothing_out():
    with Emulator(mode=Mode.STREAMING) as emulator:
        host = Host(emulator)
        scans = host.collect(2)
        with emulator._lock:
            time.sleep(0.45)
        scans += host.collect(6)
        host.stream.close()
        assert emulator.dropped == 0
    assert set(np.diff([scan.stamp_ms for scan in scans])) <= {99, 100}


def test_a_clock_of_its_own_waits_for_a_sensor_that_is_held_up():
    with Emulator(mode=Mode.STREAMING, speed=4.0) as emulator:
        with emulator._lock:
            began_ns = emulator.now_ns()
            time.sleep(0.25)  # a second of this clock
            stood_ns = emulator.now_ns()
        assert stood_ns - began_ns < PERIOD_NS
        emulator.sleep(1.0)
        assert emulator.now_ns() - stood_ns >= 1e9


def test_two_commands_in_one_write_and_a_carriage_return_are_two_commands(idle):
    _, host = idle
    host.stream.write(b"QT\rVV\r\n")
    assert [reply.echo for reply in host.collect(2)] == [b"QT", b"VV"]


def test_the_host_may_close_and_open_again(idle):
    emulator, host = idle
    host.stream.close()
    again = Host(emulator)
    again.send(b"QT")
    assert len(again.collect(1)) == 1
    again.stream.close()


def test_unplugged_it_has_no_port_and_the_host_is_told(tmp_path):
    link = tmp_path / "laser"
    with Emulator(mode=Mode.IDLE, link=link) as emulator:
        host = Host(emulator)
        assert os.path.realpath(link) == emulator.terminal
        emulator.unplug()
        assert emulator.port == ""
        assert not link.exists()
        with pytest.raises(TransportError):
            host.collect(1)
        host.stream.close()
        emulator.plug(tmp_path / "other")
        assert emulator.port == str(tmp_path / "other")
        assert emulator.sensor.mode is Mode.SCIP1


def test_the_sensors_clock_runs_apart_as_told():
    with Emulator(mode=Mode.IDLE, drift=0.01, speed=4.0) as emulator:
        host = Host(emulator)
        host.send(b"MD0044072501000")
        scans = host.collect(40)[1:]
        host.stream.close()
        sent = dict(emulator.sweeps)
    span_ms = scans[-1].stamp_ms - scans[0].stamp_ms
    true_ms = (sent[scans[-1].stamp_ms] - sent[scans[0].stamp_ms]) / 1e6
    assert span_ms / true_ms == pytest.approx(1.01, abs=1e-3)


def test_a_room_has_equal_neighbours_and_the_errors_of_a_real_sensor():
    seen = still_room(seed=1)(np.zeros(682, dtype=np.int64))
    valid = seen >= 20
    neighbours = valid[1:] & valid[:-1]
    assert 0.3 < (np.diff(seen)[neighbours] == 0).mean() < 0.6
    assert set(seen[~valid]) == {0, 6, 7, 9}
    assert 1400 < np.median(seen[valid]) < 2600


def test_every_ray_is_asked_for_at_its_own_time():
    asked = []

    def scene(ray_times_ns):
        asked.append(ray_times_ns)
        return np.full(len(ray_times_ns), 1000, dtype=np.int32)

    with Emulator(scene, mode=Mode.STREAMING) as emulator:
        host = Host(emulator)
        host.collect(2)
        host.stream.close()
        steps_0 = [step_0_ns for _, step_0_ns in emulator.sweeps]
    first = asked[0]
    assert first.shape == (682,)
    assert np.diff(first) == pytest.approx(PERIOD_NS / 1024, abs=1)
    assert first[0] - 44 * PERIOD_NS / 1024 == pytest.approx(
        min(steps_0, key=lambda t: abs(t - first[0])), abs=2
    )
