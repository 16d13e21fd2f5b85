"""Commands and telemetry of the Create, byte by byte as the specification prints them."""

import pytest

from drivers.create import protocol, stream
from drivers.create.protocol import CommandDecoder, Op
from drivers.create.stream import PACKETS, SHORT_PACKETS, Rule, StreamDecoder, Telemetry

SPEC_PACKETS = (7, 8, 9, 10, 11, 12, 13, 14, 18, 21, 22, 23, 24, 25, 26, 34, 35)
SPEC_VALUES = {7: 0x10, 22: 16012, 23: -213, 24: 24, 25: 2345, 26: 2702, 35: 2}
SPEC_FRAME = bytes.fromhex(
    "13 26 07 10 08 00 09 00 0a 00 0b 00 0c 00 0d 00 0e 00 12 00 15 00 16 3e 8c 17 ff 2b 18 18 19 09 29"
    "1a 0a 8e 22 00 23 02"
)
GOOD = {22: 14800, 24: 25, 25: 2000, 26: 2700, 35: 2}


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        (protocol.drive(-200, 500), [137, 255, 56, 1, 244]),
        (protocol.drive(200, protocol.STRAIGHT), [137, 0, 200, 128, 0]),
        (protocol.drive(200, 0x7FFF), [137, 0, 200, 127, 255]),
        (protocol.drive(100, protocol.SPIN_CLOCKWISE), [137, 0, 100, 255, 255]),
        (protocol.drive(100, protocol.SPIN_COUNTER_CLOCKWISE), [137, 0, 100, 0, 1]),
        (protocol.drive_direct(200, -200), [145, 0, 200, 255, 56]),
        (protocol.STAND, [145, 0, 0, 0, 0]),
        (protocol.start(), [128]),
        (protocol.safe(), [131]),
        (protocol.full(), [132]),
        (protocol.stop_interface(), [173]),
        (protocol.baud(57600), [129, 10]),
        (protocol.baud(19200), [129, 7]),
        (protocol.pause_stream(), [150, 0]),
        (protocol.resume_stream(), [150, 1]),
        (protocol.stream((29, 13)), [148, 2, 29, 13]),
        (protocol.query((7, 35)), [149, 2, 7, 35]),
        (protocol.leds(play=True, advance=False, colour=255, intensity=128), [139, 2, 255, 128]),
        (protocol.RESYNCHRONISE, [0] * 40 + [145, 0, 0, 0, 0, 128]),
    ],
)
def test_a_command_is_these_bytes(command, expected):
    assert list(command) == expected


@pytest.mark.parametrize(
    ("v", "w", "base", "expected"),
    [
        (0.2, 0.0, 0.258, (200, 200)),
        (0.2, 0.4, 0.258, (148, 252)),
        (0.0, 1.0, 0.258, (-129, 129)),
        (0.0, 2.0, 0.235, (-235, 235)),
        (0.5, 2.0, 0.258, (160, 500)),
        (0.0, 0.0, 0.258, (0, 0)),
    ],
)
def test_a_motion_becomes_these_wheel_speeds(v, w, base, expected):
    assert protocol.wheel_speeds(v, w, base) == expected


def test_saturated_wheels_keep_the_curve():
    left, right = protocol.wheel_speeds(0.5, 2.0, 0.258)
    assert (right - left) / (right + left) * 2 / 0.258 == pytest.approx(4.0, abs=0.02)


def test_wheel_speeds_beyond_the_robot_are_refused():
    with pytest.raises(ValueError, match="left_mmps = -501, must be within"):
        protocol.drive_direct(0, -501)


@pytest.mark.parametrize("radius", [0, 2001, -2001, 0x8001])
def test_a_radius_that_means_something_else_is_refused(radius):
    with pytest.raises(ValueError, match=f"radius_mm = {radius}"):
        protocol.drive(100, radius)


@pytest.mark.parametrize("packet", [0, 2, 6, 19, 20, 100])
def test_distance_and_angle_cannot_be_asked_for(packet):
    for ask in (protocol.stream, protocol.query):
        with pytest.raises(ValueError, match=f"packet {packet} carries distance or angle"):
            ask((7, packet))
    with pytest.raises(ValueError, match="never asked for"):
        stream.check_list((7, packet), 57600)


def test_an_unknown_baud_rate_is_refused():
    with pytest.raises(ValueError, match="baud = 56000"):
        protocol.baud(56000)


@pytest.mark.parametrize(("first", "last", "size"), [
    (7, 26, 26), (7, 16, 10), (17, 20, 6), (21, 26, 10), (27, 34, 14), (35, 42, 12), (7, 42, 52),
])  # fmt: skip
def test_the_packets_of_a_group_have_the_groups_size(first, last, size):
    assert sum(stream.SIZES[i] for i in range(first, last + 1)) == size


@pytest.mark.parametrize(
    ("ids", "baud", "size"), [(SPEC_PACKETS, 57600, 41), (PACKETS, 57600, 47), (SHORT_PACKETS, 19200, 20)]
)
def test_our_lists_fit(ids, baud, size):
    assert stream.frame_bytes(ids) == size
    stream.check_list(ids, baud)


def test_a_list_too_long_for_its_baud_rate_is_refused():
    with pytest.raises(ValueError, match="47 bytes, must be at most 28 at 19200 baud"):
        stream.check_list(PACKETS, 19200)
    with pytest.raises(ValueError, match="must be at most 86 at 57600"):
        stream.check_list((*(i for i in range(7, 43) if i not in (19, 20)), 7), 57600)


@pytest.mark.parametrize(("rule", "last"), [(Rule.WITH_HEADER, 0xA7), (Rule.WITHOUT_HEADER, 0xBA)])
def test_the_frame_of_the_specification_is_read_and_written(rule, last):
    frame = SPEC_FRAME + bytes((last,))
    assert stream.encode_frame(SPEC_PACKETS, SPEC_VALUES, rule) == frame
    decoder = StreamDecoder(SPEC_PACKETS)
    (telemetry,) = decoder.feed(frame)
    assert telemetry == Telemetry(
        bumps_and_drops=0x10, voltage_mv=16012, current_ma=-213, temperature_c=24, charge_mah=2345,
        capacity_mah=2702, mode=2,
    )  # fmt: skip
    assert telemetry.wheel_drops == 0b100
    assert telemetry.bumps == 0
    assert decoder.skipped_bytes == 0


@pytest.mark.parametrize(("sum_byte", "accepted"), [(182, 1), (163, 1), (170, 0)])
def test_the_examples_of_both_documents_are_right_sums(sum_byte, accepted):
    frame = bytes((19, 5, 29, 2, 25, 13, 0, sum_byte))
    decoder = StreamDecoder((29, 13))
    decoder.feed(frame)
    # The example carries no voltage, so it is not plausible: what counts is that its sum was right.
    assert (decoder.implausible_frames, decoder.checksum_errors) == (accepted, 1 - accepted)


def test_left_and_front_cliffs_have_their_own_bits():
    for packet, bit in ((9, 8), (10, 4), (11, 2), (12, 1)):
        (telemetry,) = StreamDecoder().feed(stream.encode_frame(PACKETS, GOOD | {packet: 1}))
        assert telemetry.cliffs == bit


def test_five_equal_sums_in_a_row_decide_the_rule():
    decoder = StreamDecoder()
    ours, other = (stream.encode_frame(PACKETS, GOOD, rule) for rule in Rule)
    assert len(decoder.feed(ours * 4 + other + ours * 4)) == 9
    assert decoder.rule is None
    decoder.feed(ours)
    assert decoder.rule is Rule.WITH_HEADER
    assert decoder.feed(other) == []
    assert decoder.checksum_errors > 0
    assert len(decoder.feed(ours)) == 1


def test_a_header_inside_the_data_costs_nothing():
    look_alike = 0x13 << 8 | stream.frame_bytes(PACKETS) - 3
    frame = stream.encode_frame(PACKETS, GOOD | {25: look_alike, 26: look_alike})
    decoder = StreamDecoder()
    assert len(decoder.feed(frame[9:] + frame * 3)) == 3
    assert decoder.frames == 3


@pytest.mark.parametrize(
    ("values", "why"),
    [
        ({22: 4902}, "voltage"),
        ({22: 26000}, "voltage"),
        ({24: 90}, "heat"),
        ({35: 5}, "mode"),
        ({21: 6}, "charging"),
    ],
)
def test_an_impossible_value_costs_its_frame(values, why):
    decoder = StreamDecoder()
    good = stream.encode_frame(PACKETS, GOOD)
    assert len(decoder.feed(good + stream.encode_frame(PACKETS, GOOD | values) + good)) == 2, why
    assert decoder.implausible_frames == 1


def test_a_hazard_of_an_older_frame_is_kept_in_the_newest():
    frames = [
        Telemetry(voltage_mv=15000, bumps_and_drops=1),
        Telemetry(voltage_mv=15001, cliffs=4),
        Telemetry(voltage_mv=15002, overcurrents=8),
        Telemetry(voltage_mv=15003),
    ]
    merged = stream.newest_of(frames)
    assert (merged.voltage_mv, merged.bumps_and_drops, merged.cliffs, merged.overcurrents) == (15003, 1, 4, 8)


def test_the_robot_reads_back_every_command_we_write():
    wire = protocol.start() + protocol.stream(PACKETS) + protocol.safe() + protocol.drive_direct(-3, 250)
    commands = CommandDecoder().feed(wire)
    assert [c.op for c in commands] == [Op.START, Op.STREAM, Op.SAFE, Op.DRIVE_DIRECT]
    assert commands[1].data == bytes((len(PACKETS), *PACKETS))
    assert commands[3].wheels() == (-3, 250)


def test_a_cut_command_takes_its_missing_bytes_from_the_next():
    decoder = CommandDecoder()
    assert decoder.feed(bytes((145, 0))) == []
    assert decoder.waiting
    (command,) = decoder.feed(bytes((128, 128, 128)) + protocol.start())[:1]
    assert command.data == bytes((0, 128, 128, 128))  # a Start lost, and the wheels told something wild


def test_the_resynchronisation_ends_any_cut_command_and_stops_the_wheels():
    for cut in (b"\x91", b"\x91\x01", b"\x91\x01\xf4\x01", b"\x94\x10\x07", b"\x8b\x00", b"\x8c\x00\x10"):
        decoder = CommandDecoder()
        decoder.feed(cut)
        commands = decoder.feed(protocol.RESYNCHRONISE)
        assert commands[-2:] == [
            protocol.Command(Op.DRIVE_DIRECT, bytes(4)),
            protocol.Command(Op.START),
        ], cut


def test_a_song_and_a_script_have_the_length_they_say():
    decoder = CommandDecoder()
    commands = decoder.feed(bytes((140, 1, 2, 60, 32, 64, 32)) + bytes((152, 1, 128)) + protocol.safe())
    assert [(c.op, len(c.data)) for c in commands] == [(140, 6), (152, 2), (131, 0)]


def test_opcodes_the_robot_does_not_know_are_skipped_and_counted():
    decoder = CommandDecoder()
    assert [c.op for c in decoder.feed(b"AT\r\n\x00\x00" + protocol.start())] == [Op.START]
    assert decoder.unknown_bytes == 6
