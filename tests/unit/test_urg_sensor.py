"""The emulated sensor's answers, request by request, against the tables of the specification."""

import dataclasses

import numpy as np
import pytest

from drivers.urg04lx.decoder import Decoder, Reply, ScanReply
from drivers.urg04lx.information import parse_information, parse_parameters, parse_version, sensor_time_ms
from drivers.urg04lx.model import URG_04LX, URG_04LX_UG01, Mode
from drivers.urg04lx.protocol import StreamRequest, decode_single
from drivers.urg04lx.sensor import Sensor

SWEEP = np.arange(1000, 1682, dtype=np.int32)


def ask(sensor, line, now_ms=123_456):
    """Ask through the decoder; return the reply."""
    (reply,) = Decoder().feed(sensor.answer(line, now_ms, SWEEP))
    assert isinstance(reply, Reply)
    assert reply.echo == line
    return reply


@pytest.fixture
def idle():
    return Sensor(URG_04LX, Mode.IDLE)


def test_after_power_on_a_urg_04lx_speaks_scip_1_and_is_switched():
    sensor = Sensor(URG_04LX)
    assert sensor.answer(b"QT", 0) == b"QT\nE\n\n"
    version = parse_information(ask(sensor, b"V").lines)
    assert version.get("PROD") == "SOKUIKI Sensor URG-04LX"
    assert version.get("FIRM").startswith("3.1.04,07/08/02(20-4095[mm],240[deg],44-725[step]")
    assert sensor.answer(b"SCIP2.0", 0) == b"SCIP2.0\n0\n\n"
    assert sensor.answer(b"SCIP2.0", 0) == b"SCIP2.0\n0Ee\n\n"
    assert ask(sensor, b"QT").status == b"00"


def test_a_ug01_speaks_scip_2_from_the_start():
    sensor = Sensor(URG_04LX_UG01)
    version = parse_version(ask(sensor, b"VV").lines)
    assert version.ug01
    assert version.serial == "H1510998"
    assert version.warnings == ()


def test_old_firmware_refuses_the_switch():
    sensor = Sensor(dataclasses.replace(URG_04LX, has_scip2=False))
    assert sensor.answer(b"SCIP2.0", 0) == b"SCIP2.0\nE\n\n"


def test_version_and_parameters_are_the_recorded_ones_byte_for_byte(idle):
    assert idle.answer(b"VV", 0) == (
        b"VV\n00P\nVEND:Hokuyo Automatic Co.,Ltd.;[\nPROD:SOKUIKI Sensor URG-04LX;[\n"
        b"FIRM:3.1.04(02/Aug./2007);a\nPROT:SCIP 2.0;N\nSERI:H0706400;F\n\n"
    )
    assert idle.answer(b"PP", 0) == (
        b"PP\n00P\nMODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N\nDMIN:20;4\nDMAX:5600;_\nARES:1024;\\\n"
        b"AMIN:44;7\nAMAX:725;o\nAFRT:384;6\nSCAN:600;e\n\n"
    )
    assert parse_parameters(ask(idle, b"PP").lines) == URG_04LX.parameters
    state = parse_information(ask(idle, b"II", 6487).lines)
    assert (state.get("LASR"), state.get("MESM"), sensor_time_ms(state)) == ("OFF", "IDLE", 6487)


def test_the_laser_is_switched_on_and_off(idle):
    assert [ask(idle, line).status for line in (b"BM", b"BM", b"QT", b"QT", b"BM")] == [
        b"00", b"02", b"00", b"00", b"00",
    ]  # fmt: skip


def test_time_mode_answers_only_about_time(idle):
    statuses = [
        ask(idle, line).status for line in (b"TM1", b"TM0", b"TM0", b"QT", b"VV", b"TM3", b"TM2", b"TM2")
    ]
    assert statuses == [b"04", b"00", b"02", b"0E", b"0E", b"01", b"00", b"03"]
    ask(idle, b"TM0")
    assert idle.answer(b"TM1", 123_456) == b"TM1\n00P\n0N90W\n\n"


def test_rates_are_changed_and_put_back_by_a_reset(idle):
    statuses = [ask(idle, line).status for line in (b"SS115200", b"SS038400", b"SS019200")]
    assert statuses == [b"00", b"02", b"03"]
    assert idle.answer(b"SSabcdef", 0) == b"SSabcdef\n01Q\n\n"
    assert idle.next_baud == 115_200
    ask(idle, b"RS")
    assert idle.next_baud == 19_200
    assert idle.timer_reset


def test_sensitivity_is_unknown_to_old_firmware(idle):
    assert ask(idle, b"HS0").status == b"0C"
    new = Sensor(URG_04LX_UG01)
    assert [ask(new, line).status for line in (b"HS1", b"HS1", b"HS0", b"HS7")] == [
        b"00",
        b"02",
        b"00",
        b"01",
    ]


@pytest.mark.parametrize(
    ("line", "status"),
    [
        (b"MDxxxx072501000", b"01"), (b"MD0044xxxx01000", b"02"), (b"MD00440725xx000", b"03"),
        (b"MD0044076901000", b"04"), (b"MD0725004401000", b"05"), (b"MD0044072501x00", b"06"),
        (b"MD00440725010xx", b"07"), (b"MD0044", b"0C"), (b"GD0044072501", b"10"), (b"XX", b"0E"),
        (b"QT;" + b"a" * 17, b"0G"), (b"QT;a!b", b"0H"), (b"CR05", b"04"), (b"CR00", b"03"),
    ],
)  # fmt: skip
def test_a_wrong_request_gets_the_documented_status(idle, line, status):
    reply = idle.answer(line, 0)
    assert reply.startswith(line + b"\n" + status)
    assert reply.endswith(b"\n\n")


def test_a_finite_stream_counts_down_and_ends(idle):
    request = StreamRequest(first_step=380, last_step=388, scans=4)
    assert idle.answer(request.encode(), 0) == b"MD0380038801004\n00P\n\n"
    decoder = Decoder(request)
    remaining = []
    while idle.stream:
        (scan,) = decoder.feed(idle.scan(123, SWEEP))
        assert isinstance(scan, ScanReply)
        remaining.append(scan.remaining)
    assert remaining == [3, 2, 1, 0]
    assert idle.mode is Mode.IDLE


def test_steps_outside_the_view_read_19_and_a_group_its_smallest_distance(idle):
    sweep = SWEEP.copy()
    sweep[0:4] = (7, 1500, 1200, 0)
    sweep[4:6] = (6, 9)
    request = StreamRequest(first_step=42, last_step=51, cluster=2)
    idle.answer(request.encode(), 0)
    (scan,) = Decoder(request).feed(idle.scan(0, sweep))
    assert isinstance(scan, ScanReply)
    assert scan.values.tolist() == [19, 1500, 1200, 6, 1006]


def test_a_single_scan_needs_the_laser_and_gives_the_sweep(idle):
    ask(idle, b"BM")
    reply = ask(idle, b"GS0044072501", 99)
    single = decode_single(reply.lines, 2)
    assert single is not None
    assert single[0] == 99
    assert single[1].tolist() == SWEEP.tolist()


@pytest.mark.parametrize("line", [b"ME00440725010000", b"GE0044072501"])
def test_asking_for_intensities_hangs_it_until_the_power_is_cut(idle, line):
    assert idle.answer(line, 0) == b""
    assert idle.answer(b"QT", 0) == b""


def test_a_unit_that_takes_a_second_version_amiss_falls_silent():
    sensor = Sensor(dataclasses.replace(URG_04LX, mute_after_versions=2, odd_version=True), Mode.IDLE)
    version = parse_version(ask(sensor, b"VV").lines)
    assert version.serial == "H0706400"
    assert len(version.warnings) == 2
    ask(sensor, b"VV")
    assert sensor.answer(b"QT", 0) == b""


def test_waiting_for_firmware_it_tells_only_who_it_is():
    sensor = Sensor(URG_04LX, Mode.UPDATE)
    statuses = [ask(sensor, line).status for line in (b"QT", b"PP", b"VV", b"II", b"RS", b"QT")]
    assert statuses == [b"0I", b"0I", b"00", b"00", b"00", b"0I"]
