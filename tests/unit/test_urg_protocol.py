"""SCIP requests, replies, numbers and sums, against the worked examples of the maker and of real captures."""

import math

import numpy as np
import pytest

from drivers.urg04lx.geometry import RS232_BAUDS, Sweep, check_budget, reply_bytes, to_ranges
from drivers.urg04lx.information import (
    Parameters,
    parse_information,
    parse_parameters,
    parse_version,
    sensor_time_ms,
)
from drivers.urg04lx.protocol import (
    StreamRequest,
    checksum,
    data_lines,
    decode_single,
    decode_value,
    decode_values,
    encode_information,
    encode_reply,
    encode_scan,
    encode_value,
    encode_values,
    status_of,
    with_sum,
)
from drivers.urg04lx.settings import UrgConfig

STATUSES = "00 01 02 03 04 05 06 07 08 10 21 49 50 97 98 99 0A 0B 0C 0D 0E 0F 0G 0H 0I 0L 0M"
SUMS = "P Q R S T U V W X Q S ] U ` a b a b c d e f g h i l m"
STATUS_SUMS = dict(zip(STATUSES.split(), SUMS.split(), strict=True))
NUMBERS = [
    (1234, 2, b"CB"), (5432, 3, b"1Dh"), (16_000_000, 4, b"m2@0"), (0, 2, b"00"), (4095, 2, b"oo"),
    (4095, 3, b"0oo"), (5600, 3, b"1GP"), (20, 2, b"0D"), (20, 3, b"00D"), (19, 3, b"00C"), (6, 3, b"006"),
    (7, 3, b"007"), (1000, 2, b"?X"), (1000, 3, b"0?X"), (2000, 3, b"0O@"), (262143, 3, b"ooo"),
    (123456, 4, b"0N90"), (16_777_215, 4, b"oooo"),
]  # fmt: skip
REAL_LINES = [
    b"VEND:Hokuyo Automatic Co.,Ltd.;[", b"PROD:SOKUIKI Sensor URG-04LX;[", b"FIRM:3.1.04(02/Aug./2007);a",
    b"PROT:SCIP 2.0;N", b"SERI:H0706400;F", b"MODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N", b"DMIN:20;4",
    b"DMAX:5600;_", b"ARES:1024;\\", b"AMIN:44;7", b"AMAX:725;o", b"AFRT:384;6", b"SCAN:600;e",
    b"LASR:OFF;7", b"LASR:ON;9", b"SCSP:Initial(600[rpm])<-Default setting by user;A", b"MESM:IDLE;:",
    b"MESM:CLASSIC;^", b"SBPS:19200[bps]<-Default setting by user;A", b"TIME:001957;O", b"TIME:6A5404;]",
    b"STAT:Sensor works well.;8", b"PROD:SOKUIKI Sensor URG-04LX-UG01(Simple-URG);[",
    b"FIRM:3.4.03(17/Dec./2012);T", b"SERI:H1510998;V", b"MESM:Measuring by Normal Mode;0",
    b"MESM:Measuring by Sensitive Mode;A",
]  # fmt: skip


@pytest.mark.parametrize(("status", "character"), STATUS_SUMS.items())
def test_a_status_has_the_documented_sum(status, character):
    assert with_sum(status.encode()) == (status + character).encode()
    assert status_of((status + character).encode()) == status.encode()


def test_a_status_with_a_wrong_sum_is_none_and_scip_1_has_one_character():
    assert status_of(b"00Q") is None
    assert status_of(b"") is None
    assert status_of(b"00") is None
    assert status_of(b";") is None
    assert [status_of(b"0"), status_of(b"E"), status_of(b"0Ee")] == [b"0", b"E", b"0E"]


@pytest.mark.parametrize(("value", "width", "text"), NUMBERS)
def test_a_number_is_written_and_read_as_documented(value, width, text):
    assert encode_value(value, width) == text
    assert decode_value(text) == value
    assert encode_values([value], width) == text
    assert decode_values(text, width).tolist() == [value]


@pytest.mark.parametrize("width", [2, 3, 4])
def test_a_number_that_does_not_fit_is_refused(width):
    with pytest.raises(ValueError, match=f"value = {1 << 6 * width}"):
        encode_value(1 << 6 * width, width)
    with pytest.raises(ValueError, match="do not fit"):
        encode_values([0, 1 << 6 * width], width)
    with pytest.raises(ValueError, match="do not fit"):
        encode_values([-1], width)


@pytest.mark.parametrize("line", REAL_LINES)
def test_a_real_line_of_information_is_read_without_a_warning_and_written_the_same(line):
    tag, text = line[:-2].decode().split(":", 1)
    found = parse_information([line])
    assert found.get(tag) == text
    assert found.warnings == ()
    assert encode_information(tag, text) == line


def test_either_reading_of_the_semicolon_is_a_good_sum():
    body = b"SERI:H0706400"
    line = body + b";" + bytes((checksum(body + b";"),))
    assert parse_information([line]).warnings == ()


def test_a_real_block_decodes_across_its_line_end():
    line = b"0AI0AI0AJ0AK0AP0A\\0Ac0Aj0An0Ao0Ao0B00B30B80B90B@0BJ0BK0BR0BR0BR0"
    assert checksum(line) == ord(":")
    assert decode_values(line[:63], 3).tolist() == [
        1113, 1113, 1114, 1115, 1120, 1132, 1139, 1146, 1150, 1151, 1151, 1152, 1155, 1160, 1161, 1168,
        1178, 1179, 1186, 1186, 1186,
    ]  # fmt: skip


def test_a_value_split_over_two_lines_is_written_as_in_the_example():
    reply = encode_scan(b"GD0384040501", b"00", 0, [5432] * 22, 3)
    assert reply == b"GD0384040501\n00P\n00000\n" + b"1Dh" * 21 + b"1B\nDh\\\n\n"
    lines = tuple(reply[:-2].split(b"\n")[2:])
    single = decode_single(lines, 3)
    assert single is not None
    assert single[0] == 0
    assert single[1].tolist() == [5432] * 22


@pytest.mark.parametrize("line", [0, 1, 2])
def test_a_damaged_line_of_a_single_scan_is_seen(line):
    reply = encode_scan(b"GD0384040501", b"00", 77, [5432] * 22, 3)
    lines = list(reply[:-2].split(b"\n")[2:])
    lines[line] = bytes((lines[line][0] ^ 2,)) + lines[line][1:]
    assert decode_single(tuple(lines), 3) is None
    assert decode_single((), 3) is None


VALUES = [1000, 1001, 0, 7, 715, 2000, 4095, 5600, 19]


def test_the_worked_exchange_is_written_byte_for_byte():
    request = StreamRequest(first_step=380, last_step=388, scans=4)
    assert request.encode() == b"MD0380038801004"
    assert encode_reply(request.encode(), b"00") == b"MD0380038801004\n00P\n\n"
    wide = encode_scan(request.echo(3), b"99", 123456, VALUES, 3)
    assert wide == b"MD0380038801003\n99b\n0N90W\n0?X0?Y0000070;;0O@0oo1GP00CD\n\n"
    narrow = StreamRequest(first_step=380, last_step=388, scans=4, wide=False)
    assert encode_scan(narrow.echo(3), b"99", 123456, VALUES, 2) == (
        b"MS0380038801003\n99b\n0N90W\n?X?Y0007;;O@oooo0CZ\n\n"
    )


def test_our_request_is_the_one_everybody_sends_and_reads_back():
    assert StreamRequest().encode() == b"MD0044072501000"
    assert StreamRequest.parse(b"MD0044072501000") == StreamRequest()
    odd = StreamRequest(first_step=128, last_step=640, cluster=27, skip=3, scans=99, wide=False)
    assert StreamRequest.parse(odd.encode()) == odd
    for wrong in (b"MD004407250100", b"MX0044072501000", b"MD00440725010x0"):
        with pytest.raises(ValueError, match="request"):
            StreamRequest.parse(wrong)


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"first_step": -1}, "steps = -1"),
        ({"last_step": 769}, "769"),
        ({"first_step": 700, "last_step": 600}, "first <= last"),
        ({"cluster": 0}, "cluster = 0"),
        ({"cluster": 100}, "cluster = 100"),
        ({"skip": 10}, "skip = 10"),
        ({"scans": 100}, "scans = 100"),
    ],
)
def test_a_request_the_protocol_cannot_express_names_field_and_value(wrong, named):
    with pytest.raises(ValueError, match=named):
        StreamRequest(**wrong)


def test_data_lines_hold_64_characters_and_a_sum_each():
    lines = data_lines(b"0" * 130).split(b"\n")
    assert [len(line) for line in lines] == [65, 65, 3, 0]
    assert all(checksum(line[:-1]) == line[-1] for line in lines if line)


BUDGET = {
    (44, 725, 1, True): (2137, [1113, 371, 185.5, 85.5, 42.7, 28.5]),
    (44, 725, 1, False): (1435, [747, 249, 124.6, 57.4, 28.7, 19.1]),
    (44, 725, 2, True): (1082, [564, 188, 93.9, 43.3, 21.6, 14.4]),
    (44, 725, 2, False): (731, [381, 127, 63.5, 29.2, 14.6, 9.7]),
    (128, 640, 1, True): (1616, [842, 281, 140.3, 64.6, 32.3, 21.5]),
    (128, 640, 1, False): (1087, [566, 189, 94.4, 43.5, 21.7, 14.5]),
    (0, 768, 1, True): (2408, [1254, 418, 209, 96.3, 48.2, 32.1]),
    (0, 768, 1, False): (1615, [841, 280, 140.2, 64.6, 32.3, 21.5]),
}


@pytest.mark.parametrize(("steps", "expected"), BUDGET.items())
def test_the_size_of_a_scan_and_what_fits_are_those_of_the_table(steps, expected):
    first, last, cluster, wide = steps
    request = StreamRequest(first_step=first, last_step=last, cluster=cluster, wide=wide)
    size, milliseconds = expected
    assert reply_bytes(request) == size
    assert len(encode_scan(request.echo(0), b"99", 1, [1000] * request.count, request.width)) == size
    for baud, took_ms in zip(RS232_BAUDS, milliseconds, strict=True):
        if took_ms > 100:
            with pytest.raises(ValueError, match=f"baud = {baud}: {size} bytes"):
                check_budget(request, baud)
        else:
            check_budget(request, baud)


def test_a_configuration_that_the_line_cannot_carry_is_refused_before_anything_is_opened():
    with pytest.raises(ValueError, match=r"baud = 115200: 2137 bytes a scan take 185.5 ms, there are 100 ms"):
        UrgConfig(port="/dev/ttyS0", baud=115_200)
    assert UrgConfig(port="/dev/ttyS0", baud=115_200, skip=1).request(Parameters()).skip == 1
    assert UrgConfig(port="/dev/ttyS0", baud=115_200, wide=False, cluster=2).baud == 115_200


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        ({"port": ""}, "port"),
        ({"baud": 38_400}, "baud = 38400"),
        ({"port": "/dev/ttyUSB0"}, "baud = 0 means USB"),
        ({"skip": 12}, "skip = 12"),
        ({"cluster": 0}, "cluster = 0"),
        ({"first_step": 800}, "steps = 800"),
    ],
)
def test_a_wrong_configuration_names_the_field_and_its_value(wrong, named):
    with pytest.raises(ValueError, match=named):
        UrgConfig(**wrong)


def test_a_last_group_that_is_not_full_is_not_asked_for():
    request = UrgConfig(cluster=3).request(Parameters())
    assert (request.last_step, request.count) == (724, 227)


@pytest.mark.parametrize(
    ("step", "degrees", "milliseconds"),
    [
        (44, -119.53125, 4.297),
        (128, -90.0, 12.5),
        (384, 0.0, 37.5),
        (640, 90.0, 62.5),
        (725, 119.8828125, 70.801),
    ],
)
def test_a_step_points_and_is_taken_where_and_when_the_table_says(step, degrees, milliseconds):
    sweep = Sweep.of(StreamRequest(), Parameters())
    index = step - 44
    assert math.degrees(sweep.angle_min_rad + index * sweep.angle_increment_rad) == pytest.approx(degrees)
    assert (sweep.first_ray_s + index * sweep.time_increment_s) * 1e3 == pytest.approx(milliseconds, abs=5e-4)
    assert sweep.count == 682
    assert (sweep.range_min_m, sweep.range_max_m, sweep.period_s) == (0.02, 5.6, 0.1)


def test_a_group_of_steps_points_to_its_middle():
    sweep = Sweep.of(StreamRequest(cluster=2), Parameters())
    assert sweep.count == 341
    assert math.degrees(sweep.angle_min_rad) == pytest.approx((44.5 - 384) * 360 / 1024)
    assert math.degrees(sweep.angle_increment_rad) == pytest.approx(720 / 1024)
    assert sweep.first_ray_s == pytest.approx(44.5 * 0.1 / 1024)


@pytest.mark.parametrize("code", range(20))
def test_every_error_code_is_no_information_and_is_counted(code):
    ranges = to_ranges(np.array([1000, code, 20], dtype=np.int32), StreamRequest(), Parameters())
    assert np.isnan(ranges.metres).tolist() == [False, True, False]
    assert ranges.codes[code] == ranges.codes.sum() == 1
    assert ranges.metres[2] == np.float32(0.02)


def test_beyond_the_guarantee_is_kept_and_counted_and_beyond_the_maximum_is_not_kept():
    values = np.array([4095, 4096, 5600, 5601, 262143], dtype=np.int32)
    ranges = to_ranges(values, StreamRequest(), Parameters())
    assert ranges.metres[:3].tolist() == [np.float32(4.095), np.float32(4.096), np.float32(5.6)]
    assert np.isnan(ranges.metres[3:]).all()
    assert (ranges.beyond, ranges.impossible) == (2, 2)


def test_the_end_of_two_characters_is_not_taken_for_a_wall():
    ranges = to_ranges(np.array([4094, 4095], dtype=np.int32), StreamRequest(wide=False), Parameters())
    assert np.isnan(ranges.metres).tolist() == [False, True]
    assert ranges.impossible == 1


def test_a_version_with_an_extra_line_and_a_wrong_sum_is_read_with_warnings():
    lines = [b"VEND:Hokuyo;x", *REAL_LINES[1:4], b"SERI:H0706400;G", b"EXTRA", b"NEW:x"]
    version = parse_version(lines)
    assert version.product == "SOKUIKI Sensor URG-04LX"
    assert version.serial == "H0706400"
    assert version.supported
    assert not version.ug01
    assert len(version.warnings) == 3


def test_the_model_is_told_by_prod_and_a_ug01_is_one():
    assert parse_version([b"PROD:SOKUIKI Sensor URG-04LX-UG01(Simple-URG);["]).ug01
    assert not parse_version([b"PROD:SOKUIKI Sensor UTM-30LX;A"]).supported
    assert not parse_version([]).known


def test_parameters_of_the_sensor_are_believed_over_the_usual_ones():
    lines = [encode_information(tag, text) for tag, text in (
        ("MODL", "URG"), ("DMIN", "30"), ("DMAX", "4500"), ("ARES", "1024"), ("AMIN", "50"), ("AMAX", "700"),
        ("AFRT", "384"), ("SCAN", "540"))]  # fmt: skip
    read = parse_parameters(lines)
    assert read == Parameters(
        model="URG", range_min_mm=30, range_max_mm=4500, first_step=50, last_step=700, turns_per_minute=540
    )
    assert UrgConfig().request(read).encode() == b"MD0050070001000"


def test_missing_or_impossible_parameters_are_replaced_with_a_warning():
    some = parse_parameters([b"AMIN:44;7", b"DMAX:many;x"])
    assert some == Parameters()
    assert any("DMAX = 'many'" in warning for warning in some.warnings)
    impossible = parse_parameters([b"AMIN:700;x", b"AMAX:44;x"])
    assert impossible == Parameters()
    assert any("cannot be" in warning for warning in impossible.warnings)


def test_the_time_in_the_state_is_hexadecimal():
    assert sensor_time_ms(parse_information([b"TIME:001957;O"])) == 6487
    assert sensor_time_ms(parse_information([b"TIME:xyz;O"])) is None
    assert sensor_time_ms(parse_information([])) is None
