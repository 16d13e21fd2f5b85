"""The connect table: from every state a sensor can be in to its first scan, over a real line."""

import dataclasses
import os
import termios
import time

import numpy as np
import pytest

from drivers.errors import PortBusyError, PortForbiddenError, PortMissingError, ProtocolError
from drivers.ports import UsbPort
from drivers.transport import SerialStream
from drivers.urg04lx.emulator import Emulator
from drivers.urg04lx.events import UrgScan
from drivers.urg04lx.model import URG_04LX, URG_04LX_UG01, Mode
from drivers.urg04lx.pair import Session, attach
from drivers.urg04lx.protocol import StreamRequest

SPEED = 4.0


def connected(emulator, within_s=10.0, **wanted):
    """Run until the third scan; return the session after its end."""
    device = attach(emulator, speed=SPEED, **wanted)
    with Session(device, emulator) as session:
        assert session.more_scans(3, within_s)
    return session


def test_the_transcript_of_a_sensor_that_was_just_powered():
    with Emulator(speed=SPEED) as emulator:
        session = connected(emulator)
        assert list(emulator.requests) == [b"QT", b"SCIP2.0", b"QT", b"VV", b"PP", b"MD0044072501000", b"QT"]
    (connection,) = session.connections
    assert connection.identity.version.serial == "H0706400"
    assert connection.identity.parameters == URG_04LX.parameters
    assert session.device.decoder.damaged.total() == 0


@pytest.mark.parametrize(
    ("mode", "asked_first"),
    [
        (Mode.SCIP1, [b"QT", b"SCIP2.0", b"QT", b"VV"]),
        (Mode.IDLE, [b"QT", b"VV"]),
        (Mode.MEASURING, [b"QT", b"VV"]),
        (Mode.STREAMING, [b"QT", b"VV"]),
        (Mode.TIME, [b"QT", b"TM2", b"QT", b"VV"]),
    ],
)
def test_every_state_leads_to_scans(mode, asked_first):
    with Emulator(mode=mode, speed=SPEED) as emulator:
        session = connected(emulator)
        assert list(emulator.requests)[: len(asked_first)] == asked_first
        assert emulator.sensor.mode is Mode.IDLE  # and its laser is off afterwards
    assert [scan.ranges_m.shape for scan in session.scans[:3]] == [(682,)] * 3


def test_a_ug01_is_told_from_its_elder_by_prod():
    with Emulator(model=URG_04LX_UG01, speed=SPEED) as emulator:
        session = connected(emulator)
        assert b"SCIP2.0" not in emulator.requests
    assert session.connections[0].identity.version.ug01


def test_a_stream_of_other_steps_left_by_somebody_else_is_ended_and_none_of_it_is_taken():
    other = StreamRequest(first_step=128, last_step=640, wide=False)
    with Emulator(mode=Mode.STREAMING, stream=other, speed=SPEED) as emulator:
        session = connected(emulator)
    assert all(len(scan.ranges_m) == 682 for scan in session.scans)


def test_bytes_of_an_old_session_in_the_terminal_are_not_taken_for_an_answer():
    with Emulator(mode=Mode.IDLE, speed=SPEED) as emulator:
        emulator.send(b"QT\n0Ee\n\nMD0044072501000\n99b\n" + b"0" * 4096 + b"VV\n00P\nPROD:SOMETHING;x\n\n")
        session = connected(emulator)
    assert session.connections[0].identity.version.product == URG_04LX.product


def test_noise_of_a_modem_manager_does_not_keep_from_connecting():
    with Emulator(mode=Mode.IDLE, speed=SPEED) as emulator:
        device = attach(emulator, speed=SPEED)
        with SerialStream(emulator.port, 115_200) as intruder:
            intruder.write(b"AT\rATE0\r")
        with Session(device, emulator) as session:
            emulator.send(b"AT\n0Dd\n\nAT\n0D")
            assert session.more_scans(3)


@pytest.mark.parametrize("start_baud", [19_200, 57_600, 500_000])
def test_on_rs_232_the_rate_is_found_and_changed(start_baud):
    with Emulator(mode=Mode.IDLE, rs232=True, speed=SPEED) as emulator:
        emulator.sensor.baud = emulator.sensor.next_baud = start_baud
        session = connected(emulator, within_s=20.0, baud=500_000)
        assert (b"SS500000" in emulator.requests) == (start_baud != 500_000)
        assert emulator.sensor.baud == 500_000
    assert session.scans


def test_a_rate_without_a_constant_in_termios_works_too():
    with Emulator(mode=Mode.IDLE, rs232=True, speed=SPEED) as emulator:
        connected(emulator, within_s=20.0, baud=750_000)
        assert emulator.sensor.baud == 750_000


def test_the_first_bytes_at_a_wrong_rate_are_garbage_and_said_so_when_nothing_helps():
    with Emulator(mode=Mode.IDLE, rs232=True, speed=SPEED) as emulator:
        emulator.sensor.baud = emulator.sensor.next_baud = 38_400  # a rate that nobody tries
        device = attach(emulator, speed=SPEED, baud=500_000)
        with Session(device, emulator) as session:
            assert session.until(lambda: session.said("no answer that is understood"), 30.0)
        assert session.said("of garbage at 19200")
        assert session.said("unplug the sensor and plug it in again")


def test_a_sensor_that_boots_for_five_seconds_is_waited_for():
    with Emulator(speed=SPEED) as emulator:
        emulator.silence(5.0)
        session = connected(emulator, within_s=15.0)
    assert {notice.level for notice in session.notices} == {"warn", "ok"}


def test_answers_that_take_a_quarter_of_a_second_are_waited_for():
    with Emulator(mode=Mode.IDLE, speed=SPEED) as emulator:
        emulator.delay_answers(0.25)
        session = connected(emulator)
        assert b"RS" not in emulator.requests
    assert session.device.counts["failures"] == 0


def test_old_firmware_is_one_clear_error():
    old = dataclasses.replace(URG_04LX, has_scip2=False)
    with Emulator(model=old, speed=SPEED) as emulator:
        session = Session(attach(emulator, speed=SPEED), emulator)
        with session, pytest.raises(ProtocolError, match=r"firmware has no SCIP 2.0"):
            session.more_scans(1)


def test_another_model_is_refused_by_its_name():
    other = dataclasses.replace(URG_04LX_UG01, product="SOKUIKI Sensor TOP-URG UTM-30LX")
    with Emulator(model=other, speed=SPEED) as emulator:
        session = Session(attach(emulator, speed=SPEED), emulator)
        with session, pytest.raises(ProtocolError, match="UTM-30LX"):
            session.more_scans(1)


def test_a_sensor_that_waits_for_firmware_is_told_to_be_powered_again():
    with (
        Emulator(mode=Mode.UPDATE, speed=SPEED) as emulator,
        Session(attach(emulator, speed=SPEED), emulator) as session,
    ):
        assert session.until(lambda: session.said("cut the sensor's power"), 10.0)
        emulator.power_cycle()
        assert session.more_scans(1, 15.0)


def test_parameters_of_the_sensor_win_over_ours():
    parameters = dataclasses.replace(URG_04LX.parameters, last_step=700, range_max_mm=4500)
    narrow = dataclasses.replace(URG_04LX, parameters=parameters)

    def scene(ray_times_ns):
        return np.full(len(ray_times_ns), 1000, dtype=np.int32)

    with Emulator(scene, model=narrow, speed=SPEED) as emulator:
        session = connected(emulator)
        assert b"MD0044070001000" in emulator.requests
    assert session.connections[0].sweep.range_max_m == 4.5
    assert len(session.scans[0].ranges_m) == 657


def test_the_sensitive_mode_is_asked_for_and_missed_without_a_fuss():
    with Emulator(mode=Mode.IDLE, speed=SPEED) as emulator:
        session = connected(emulator, sensitive=True)
        assert emulator.requests.count(b"HS1") == 1
    assert session.said("no sensitive mode")
    with Emulator(model=URG_04LX_UG01, speed=SPEED) as emulator:
        session = connected(emulator, sensitive=True)
        assert emulator.sensor.sensitive
    assert not session.said("no sensitive mode")


def test_two_sensors_are_told_apart_by_their_serial_numbers_whatever_their_ports():
    other = dataclasses.replace(URG_04LX, serial="H0000002")
    with (
        Emulator(model=URG_04LX, mode=Mode.IDLE, speed=SPEED) as first,
        Emulator(model=other, mode=Mode.IDLE, speed=SPEED) as second,
    ):
        for order in ([first.port, second.port], [second.port, first.port]):
            device = attach(second, speed=SPEED, serial="H0000002")
            device._find = lambda order=order: order
            with Session(device, second) as session:
                assert session.more_scans(2, 20.0)
            assert session.connections[0].path == second.port
            assert session.connections[0].identity.version.serial == "H0000002"


def test_a_sensor_is_found_by_its_usb_identity(monkeypatch):
    with Emulator(mode=Mode.IDLE, speed=SPEED) as emulator:
        asked = []

        def on_usb(vendor, product):
            asked.append((vendor, product))
            return [UsbPort(emulator.port, vendor, product, "1-1", "URG-Series USB Driver")]

        monkeypatch.setattr("drivers.urg04lx.device.usb_ports", on_usb)
        device = attach(emulator, speed=SPEED, port="auto")
        device._find = device._find_ports
        with Session(device, emulator) as session:
            assert session.more_scans(2)
    assert asked[0] == ("15d1", "0000")


@pytest.mark.parametrize(("returning", "accepted"), [("H0706400", True), ("H0000002", False)])
def test_a_sensor_at_a_given_port_is_found_again_at_another_one_if_it_is_the_same(
    tmp_path, monkeypatch, returning, accepted
):
    link = tmp_path / "ttyACM0"
    other = dataclasses.replace(URG_04LX, serial=returning)
    with (
        Emulator(mode=Mode.IDLE, speed=SPEED, link=link) as emulator,
        Emulator(model=other, mode=Mode.IDLE, speed=SPEED) as second,
    ):
        monkeypatch.setattr(
            "drivers.urg04lx.device.usb_ports", lambda *_: [UsbPort(second.port, "15d1", "0000", "1-2", "")]
        )
        device = attach(emulator, speed=SPEED, port=str(link))
        device._find = device._find_ports
        with Session(device, emulator) as session:
            assert session.more_scans(2)
            emulator.unplug()
            assert session.more_scans(2, 6.0) == accepted
        assert session.said(f"no unit H0706400 among the sensors plugged in ({second.port}") != accepted


def test_a_unit_that_is_not_there_is_an_error_that_names_those_that_are():
    with Emulator(mode=Mode.IDLE, speed=SPEED) as emulator:
        device = attach(emulator, speed=SPEED, serial="H9999999", patience_s=1.0)
        with (
            Session(device, emulator) as session,
            pytest.raises(PortMissingError, match=r"H9999999.*H0706400"),
        ):
            session.more_scans(1, 20.0)
        assert emulator.requests.count(b"VV") == 1


def test_a_missing_port_is_an_error_after_the_patience_and_not_before():
    with Emulator(mode=Mode.IDLE, speed=SPEED) as emulator:
        device = attach(emulator, speed=SPEED, patience_s=2.0)
        emulator.unplug()
        began_ns = emulator.now_ns()
        with Session(device, emulator) as session, pytest.raises(PortMissingError, match="no URG on USB"):
            session.more_scans(1, 20.0)
        assert 1.9e9 < emulator.now_ns() - began_ns < 6e9


def test_a_sensor_plugged_in_within_the_patience_is_found():
    with Emulator(speed=SPEED) as emulator:
        device = attach(emulator, speed=SPEED, patience_s=10.0)
        emulator.unplug()
        with Session(device, emulator) as session:
            assert session.until(lambda: session.said("no URG on USB"), 5.0)
            emulator.plug()
            assert session.more_scans(2, 15.0)


def test_a_port_held_by_another_is_an_error_that_names_the_holder():
    with Emulator(mode=Mode.IDLE, speed=SPEED) as emulator, SerialStream(emulator.port, 115_200):
        device = attach(emulator, speed=SPEED, patience_s=0.5)
        with Session(device, emulator) as session, pytest.raises(PortBusyError, match="held by"):
            session.more_scans(1, 20.0)


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may open everything")
def test_a_forbidden_port_is_an_error_that_says_what_to_do():
    with Emulator(mode=Mode.IDLE, speed=SPEED) as emulator:
        os.chmod(emulator.terminal, 0)
        device = attach(emulator, speed=SPEED, patience_s=0.5)
        with Session(device, emulator) as session, pytest.raises(PortForbiddenError, match="group"):
            session.more_scans(1, 20.0)


def test_a_port_that_is_busy_for_a_moment_is_waited_for():
    with Emulator(mode=Mode.IDLE, speed=SPEED) as emulator:
        device = attach(emulator, speed=SPEED, patience_s=20.0)
        with SerialStream(emulator.port, 115_200), Session(device, emulator) as session:
            assert session.until(lambda: session.said("held by"), 5.0)
        with Session(attach(emulator, speed=SPEED), emulator) as session:
            assert session.more_scans(1, 10.0)


def test_only_harmless_requests_are_ever_sent_and_none_while_it_streams():
    with Emulator(speed=SPEED) as emulator:
        connected(emulator)
        sent = list(emulator.requests)
    begun = sent.index(b"MD0044072501000")
    assert sent[begun + 1 :] == [b"QT"]
    assert sent.count(b"VV") == 1
    assert not [line for line in sent if line[:2] in (b"ME", b"GE", b"HD", b"DB", b"CR", b"RT", b"II")]


def test_the_switch_is_sent_without_a_byte_too_many():
    with Emulator(speed=SPEED) as emulator:
        connected(emulator)
        assert emulator.requests[1] == b"SCIP2.0"


def test_bytes_that_a_terminal_would_translate_pass_unchanged():
    special = bytes((0x0A, 0x0D, 0x11, 0x13, 0x00, 0xFF, 0x03, 0x04, 0x7F))
    with Emulator(mode=Mode.IDLE) as emulator, SerialStream(emulator.port, 19_200) as stream:
        emulator.send(special)
        got, end = b"", time.monotonic() + 5.0
        while len(got) < len(special) and time.monotonic() < end:
            got += stream.read()
        assert got == special


def test_the_rate_that_a_host_sets_is_seen_at_the_other_end():
    with Emulator(mode=Mode.IDLE) as emulator, SerialStream(emulator.port, 57_600):
        fd = os.open(emulator.terminal, os.O_RDWR | os.O_NOCTTY)
        try:
            assert termios.tcgetattr(fd)[4] == termios.B57600
        finally:
            os.close(fd)


def test_scans_are_scans():
    with Emulator(speed=SPEED) as emulator:
        assert all(isinstance(scan, UrgScan) and scan.valid > 600 for scan in connected(emulator).scans)
