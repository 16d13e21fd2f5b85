"""The procedures of the driver over a real pseudo-terminal and pyserial, without node or operator."""

import termios
import time

import pytest

from drivers.create import protocol, stream
from drivers.create.device import Create, CreateConfig
from drivers.create.emulator import CreateEmulator
from drivers.create.protocol import Mode, Op
from drivers.create.stream import PACKETS, SHORT_PACKETS, Rule
from drivers.errors import PortBusyError, SilentError, TransportError
from drivers.transport import SerialStream


def line(path, baud):
    return SerialStream(path, baud, timeout_s=0.02, write_timeout_s=0.2)


@pytest.fixture
def robot():
    with CreateEmulator() as robot:
        yield robot


def device(robot, **config):
    return Create(CreateConfig(path=robot.port, **config), line)


def wait(condition, within_s=5.0, what="it"):
    end = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end, f"waited {within_s} s for {what}"
        time.sleep(0.002)


def test_the_robot_is_found_in_passive_mode_with_every_packet(robot):
    create = device(robot)
    telemetry = create.connect()
    assert (telemetry.mode, telemetry.voltage_mv, telemetry.charge_mah) == (1, 15_200, 2_500)
    assert (telemetry.right_mmps, telemetry.left_mmps) == (0, 0)
    create.close()


def test_the_first_thing_a_robot_hears_is_to_stand(robot):
    create = device(robot)
    create.connect()
    ops = [command.op for _, command in robot.commands()]
    assert ops[:3] == [Op.PAUSE_STREAM, Op.DRIVE_DIRECT, Op.START]
    assert bytes(robot.received).startswith(b"\x96\x00" + bytes(40) + b"\x91\x00\x00\x00\x00\x80")
    create.close()


@pytest.mark.parametrize("mode", [protocol.safe(), protocol.full()])
def test_a_robot_that_a_crash_left_driving_is_stopped(robot, mode):
    before = protocol.start() + mode + protocol.stream((7,)) + protocol.drive_direct(300, 300)
    robot.body.receive(before, time.monotonic_ns())
    assert robot.wheels_mmps == (300, 300)
    create = device(robot)
    assert create.connect().mode == 1
    assert robot.wheels_mmps == (0, 0)
    create.close()


def test_the_port_is_raw_eight_bits_no_parity_one_stop_bit(robot):
    create = device(robot)
    create.connect()
    iflag, oflag, cflag, lflag, _, speed, _ = termios.tcgetattr(create.fileno())
    assert cflag & termios.CSIZE == termios.CS8
    assert not cflag & (termios.PARENB | termios.CSTOPB | termios.CRTSCTS)
    assert not iflag & (termios.IXON | termios.IXOFF | termios.ICRNL | termios.ISTRIP)
    assert not oflag & termios.OPOST
    assert not lflag & (termios.ICANON | termios.ECHO | termios.ISIG)
    assert speed == termios.B57600
    create.close()


def test_every_byte_value_passes_both_ways_unchanged(robot):
    create = device(robot)
    create.connect()
    robot.received.clear()
    song = bytes((140, 1, 127)) + bytes(range(254))  # nearly every value, XON, XOFF, CR, LF, 0 and Ctrl-C too
    create._need().write(song)
    wait(lambda: len(robot.received) >= len(song), what="the song")
    assert bytes(robot.received) == song
    with robot.lock:
        robot.body.charge_mah, robot.body.capacity_mah = 0x0A0D, 0x1113
    wait(lambda: (t := create.receive(0.1)) is not None and t.capacity_mah == 0x1113, what="the bytes")
    assert create.receive(0.1).charge_mah == 0x0A0D
    create.close()


def test_two_drivers_do_not_share_a_port(robot):
    create = device(robot)
    create.connect()
    with pytest.raises(PortBusyError, match="held by"):
        device(robot).connect()
    assert create.receive(0.5) is not None
    create.close()


def test_it_can_be_started_after_it_was_left_without_a_word(robot):
    for _ in range(3):
        create = device(robot)
        create.connect()
        create.enter_safe()
        create.drive(100, 100)
        create._need().close()  # as a kill does it
        wait(lambda: robot.wheels_mmps == (100, 100), what="turning wheels")
    create = device(robot)
    assert create.connect().mode == 1
    assert robot.wheels_mmps == (0, 0)
    create.close()


def test_a_robot_at_19200_baud_is_brought_back_to_its_own_rate(robot):
    robot.change_baud(19200)
    create = device(robot)
    create.connect()
    assert (create.baud, robot.body.baud) == (57600, 57600)
    assert create.receive(0.5).charge_mah == 2_500
    create.close()


def test_a_robot_that_stays_at_19200_baud_is_read_with_the_short_list(robot, monkeypatch):
    monkeypatch.setattr("drivers.create.body.BAUD_CODES", {19200: 7})  # it knows no other rate
    robot.change_baud(19200)
    create = device(robot)
    telemetry = create.connect()
    assert create.baud == 19200
    assert (telemetry.mode, telemetry.charge_mah) == (1, None)
    asked = [c for _, c in robot.commands() if c.op == Op.STREAM]
    assert asked[-1].data[1:] == bytes(SHORT_PACKETS)
    create.close()


def test_a_create_1_setting_on_a_create_2_still_finds_it():
    with CreateEmulator(model="create2") as robot:
        create = device(robot)
        create.connect()
        assert create.baud in (57600, 115200)
        create.close()


def test_a_robot_whose_start_ends_the_stream_goes_on_streaming(robot):
    with robot.lock:
        robot.body.start_ends_stream = True
    create = device(robot)
    create.connect()
    create.enter_safe()
    wait(lambda: (t := create.receive(0.1)) is not None and t.mode == 2, what="Safe mode")
    create.enter_passive()
    wait(lambda: (t := create.receive(0.1)) is not None and t.mode == 1, what="Passive mode, and frames")
    create.close()


@pytest.mark.parametrize("rule", list(Rule))
def test_the_rule_of_the_sum_is_learnt(robot, rule):
    robot.use_rule(rule)
    create = device(robot)
    create.connect()
    wait(lambda: create.receive(0.1) is not None and create.rule is rule, what="the rule")
    create.close()


def test_safe_mode_comes_with_standing_wheels(robot):
    create = device(robot)
    create.connect()
    since_ns = time.monotonic_ns()
    create.enter_safe()
    wait(lambda: robot.mode is Mode.SAFE, what="Safe mode")
    wait(lambda: robot.drives(since_ns), what="zeros")
    assert [wheels for _, wheels in robot.drives(since_ns)] == [(0, 0)]
    create.close()


def test_left_and_right_are_not_mixed_up(robot):
    create = device(robot)
    create.connect()
    create.enter_safe()
    create.drive(50, 250)
    wait(lambda: robot.wheels_mmps == (250, 50), what="the right wheel faster than the left")
    create.close()


def test_a_silent_robot_is_one_error_that_says_what_to_do(robot):
    robot.silence()
    with pytest.raises(
        SilentError, match=r"is it on\? Is model create1 right \(57600 baud; tried 57600, 19200"
    ):
        device(robot).connect()


def test_looking_for_a_robot_ends_when_it_is_asked_to(robot):
    robot.silence()
    began = time.monotonic()
    create = Create(CreateConfig(path=robot.port), line, lambda: time.monotonic() - began > 0.3)
    with pytest.raises(TransportError, match="stopped while connecting"):
        create.connect()
    create.close()
    assert time.monotonic() - began < 2.0


def test_a_pulled_cable_is_one_error_for_reading_and_for_writing(robot):
    create = device(robot)
    create.connect()
    robot.hang_up()
    with pytest.raises(TransportError, match="stopped"):
        wait(lambda: create.receive(0.05) is Ellipsis)  # what came before the pull may still be read
    with pytest.raises(TransportError, match="stopped"):
        create.drive(0, 0)
    create.close()
    with pytest.raises(TransportError, match="not connected"):
        create.drive(0, 0)


def test_what_was_lost_is_counted_over_all_connections(robot):
    create = device(robot)
    robot.begin_with_garbage(b"\x55" * 100)
    create.connect()
    create.close()
    create.connect()
    counted = create.counters()
    assert counted["skipped_bytes"] >= 100
    assert counted["connections"] == 2
    create.close()


@pytest.mark.parametrize("model", ["create1", "create2"])
def test_our_list_of_packets_fits_every_model(model):
    config = CreateConfig(path="x", model=model)
    stream.check_list(config.packets, config.line_baud)
    assert set(PACKETS) == set(config.packets)
