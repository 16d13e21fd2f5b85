"""The decoder: every reply of the specification fed three ways, and every kind of damage to one scan."""

import itertools

import numpy as np
import pytest

from drivers.urg04lx.decoder import BUFFER_BYTES, Decoder, Reply, ScanReply
from drivers.urg04lx.protocol import StreamRequest, encode_information, encode_reply, encode_scan, with_sum

REQUEST = StreamRequest()
SMALL = StreamRequest(first_step=380, last_step=388, scans=4)
VERSION = [
    b"VEND:Hokuyo Automatic Co.,Ltd.;[", b"PROD:SOKUIKI Sensor URG-04LX;[", b"FIRM:3.1.04(02/Aug./2007);a",
    b"PROT:SCIP 2.0;N", b"SERI:H0706400;F",
]  # fmt: skip


def values(seed, count=682):
    rng = np.random.default_rng(seed)
    return np.where(rng.random(count) < 0.3, rng.integers(0, 20, count), rng.integers(20, 5601, count))


def scan(seed=0, stamp_ms=123_456, request=REQUEST):
    numbers = values(seed, request.count)
    return encode_scan(request.echo(0), b"99", stamp_ms, numbers, request.width)


REPLIES = {
    "scip 1.1: what it says to QT": (b"QT\nE\n\n", b"QT", b"E"),
    "scip 1.1: V": (b"V\n0\nVEND:Hokuyo Automatic Co.,Ltd.\nSTAT:FW Normal[FinalDist  ]\n\n", b"V", b"0"),
    "scip 1.1: the switch": (b"SCIP2.0\n0\n\n", b"SCIP2.0", b"0"),
    "the switch when it is switched": (b"SCIP2.0\n0Ee\n\n", b"SCIP2.0", b"0E"),
    "VV": (b"VV\n00P\n" + b"\n".join(VERSION) + b"\n\n", b"VV", b"00"),
    "PP": (b"PP\n00P\nMODL:URG-04LX(Hokuyo Automatic Co.,Ltd.);N\nDMIN:20;4\n\n", b"PP", b"00"),
    "II": (b"II\n00P\nLASR:OFF;7\nTIME:001957;O\nSTAT:Sensor works well.;8\n\n", b"II", b"00"),
    "BM": (b"BM\n02R\n\n", b"BM", b"02"),
    "QT": (b"QT\n00P\n\n", b"QT", b"00"),
    "QT in time mode": (b"QT\n0Ee\n\n", b"QT", b"0E"),
    "RS": (b"RS\n00P\n\n", b"RS", b"00"),
    "TM0": (b"TM0\n00P\n\n", b"TM0", b"00"),
    "TM1": (b"TM1\n00P\n0N90W\n\n", b"TM1", b"00"),
    "TM1 with a string": (b"TM1;a\n00P\n0N90W\n\n", b"TM1;a", b"00"),
    "TM2": (b"TM2\n03S\n\n", b"TM2", b"03"),
    "SS": (b"SS115200\n00P\n\n", b"SS115200", b"00"),
    "CR": (b"CR00\n03S\n\n", b"CR00", b"03"),
    "HS unknown": (b"HS0\n0Cc\n\n", b"HS0", b"0C"),
    "GD": (encode_scan(b"GD0384040501", b"00", 0, [5432] * 22, 3), b"GD0384040501", b"00"),
    "GS, laser off": (b"GS0384040501\n10Q\n\n", b"GS0384040501", b"10"),
    "MD acknowledged": (b"MD0044072501000\n00P\n\n", b"MD0044072501000", b"00"),
    "MS refused": (b"MS0044079901000\n04T\n\n", b"MS0044079901000", b"04"),
    "trouble in the stream": (b"MD0044072501000\n55Z\n\n", b"MD0044072501000", b"55"),
    "firmware update": (b"QT\n0Ii\n\n", b"QT", b"0I"),
}


def three_ways(decoder_of, data):
    """Feed whole, byte by byte, and between neighbours; return the three lists of replies."""
    whole = decoder_of().feed(data)
    slow = decoder_of()
    bytewise = [reply for at in range(len(data)) for reply in slow.feed(data[at : at + 1])]
    between = decoder_of().feed(b"RS\n00P\n\n" + data + b"BM\n00P\n\nQT\n0")
    assert between[0] == Reply(0, b"RS", b"00")
    assert between[-1] == Reply(0, b"BM", b"00")
    return whole, bytewise, between[1:-1]


@pytest.mark.parametrize("name", REPLIES)
def test_every_reply_is_read_whole_byte_by_byte_and_between_neighbours(name):
    data, echo, status = REPLIES[name]
    lines = tuple(data[:-2].split(b"\n")[2:])
    for replies in three_ways(lambda: Decoder(REQUEST), data):
        assert replies == [Reply(0, echo, status, lines)]


@pytest.mark.parametrize("request_", [REQUEST, SMALL, StreamRequest(wide=False), StreamRequest(cluster=31)])
def test_every_scan_is_read_whole_byte_by_byte_and_between_neighbours(request_):
    data = scan(3, 16_777_215, request_)
    for replies in three_ways(lambda: Decoder(request_), data):
        (reply,) = replies
        assert isinstance(reply, ScanReply)
        assert reply.stamp_ms == 16_777_215
        limit = 5600 if request_.wide else 4095
        assert reply.values.tolist() == np.minimum(values(3, request_.count), limit).tolist()


def test_the_worked_example_is_read_with_its_remaining_scans():
    decoder = Decoder(SMALL)
    (reply,) = decoder.feed(b"MD0380038801003\n99b\n0N90W\n0?X0?Y0000070;;0O@0oo1GP00CD\n\n")
    assert (reply.stamp_ms, reply.remaining) == (123_456, 3)
    assert reply.values.tolist() == [1000, 1001, 0, 7, 715, 2000, 4095, 5600, 19]


def test_sums_may_be_any_character_even_a_semicolon_or_a_backslash():
    request = StreamRequest(first_step=380, last_step=381)
    seen = {}
    for last in range(64):
        data = encode_scan(request.echo(0), b"99", 0, [64, last], 3)
        (reply,) = Decoder(request).feed(data)
        assert reply.values.tolist() == [64, last]
        seen[data[-3:-2]] = last
    assert len(seen) == 64
    assert {b";", b"\\", b"?"} <= seen.keys()


def test_the_time_of_a_scan_is_that_of_the_chunk_with_its_first_byte():
    data = scan()
    decoder = Decoder(REQUEST)
    stream = b"QT\n00P\n\n" + data + data[:10]
    cuts = [0, 5, 8 + 3, 900, len(stream)]
    replies = []
    for number, (begin, end) in enumerate(itertools.pairwise(cuts)):
        replies += decoder.feed(stream[begin:end], 1000 + number)
    assert [reply.at_ns for reply in replies] == [1000, 1001]
    (late,) = decoder.feed(data[10:], 2000)
    assert late.at_ns == 1003


def test_a_scan_after_a_lost_end_has_the_time_of_its_own_first_byte():
    first, second = scan(1), scan(2, 123_556)
    decoder = Decoder(REQUEST)
    replies = decoder.feed(first[:-2], 5) + decoder.feed(second, 6)
    assert [(reply.stamp_ms, reply.at_ns) for reply in replies] == [(123_556, 6)]
    assert decoder.damaged == {"no end": 1}


def accepted(data, request=REQUEST):
    """Feed damaged bytes and then a good scan; return the scans before the good one."""
    decoder = Decoder(request)
    replies = decoder.feed(data + scan(9, 777, request))
    scans = [reply for reply in replies if isinstance(reply, ScanReply)]
    return scans, decoder


def test_no_flip_of_any_bit_of_a_scan_passes():
    good = scan()
    positions = [at for at in range(len(good)) if at not in (13, 14)]  # the remaining count is free
    for at in positions:
        damaged = good[:at] + bytes((good[at] ^ (1 << at % 8),)) + good[at + 1 :]
        scans, _ = accepted(damaged)
        assert all(reply.stamp_ms == 777 for reply in scans), f"bit {at % 8} of byte {at}"


@pytest.mark.parametrize("remaining", [b"xx", b"0 ", b"\xff0", b"-1", b"\xb2\xb3"])
def test_a_count_of_remaining_scans_that_is_no_number_is_damage_and_raises_nothing(remaining):
    good = scan()
    scans, decoder = accepted(good[:13] + remaining + good[15:])
    assert [reply.stamp_ms for reply in scans] == [777]
    assert decoder.damaged == {"echo": 1}


def test_every_single_substitution_at_some_bytes_is_seen():
    good = scan()
    for at in (0, 5, 15, 16, 17, 18, 19, 20, 22, 24, 25, 26, 60, 90, 91, 700, 2130, 2134):
        for byte in range(256):
            if byte != good[at]:
                scans, _ = accepted(good[:at] + bytes((byte,)) + good[at + 1 :])
                assert all(reply.stamp_ms == 777 for reply in scans), f"byte {at} = {byte}"


def test_no_lost_byte_passes_and_the_next_scan_is_unharmed():
    good = scan()
    for at in [*range(100), *range(100, 2100, 37), *range(2100, len(good))]:
        scans, decoder = accepted(good[:at] + good[at + 1 :])
        stamps = [reply.stamp_ms for reply in scans]
        # Losing one of the two LF at the end costs this scan, as its end is missing.
        assert stamps == [777], f"byte {at}"
        assert decoder.damaged.total() == 1


@pytest.mark.parametrize("count", [2, 3, 8, 64, 65, 66, 130, 132])
def test_no_lost_burst_passes(count):
    good = scan()
    for at in range(0, len(good) - count, 23):
        scans, _ = accepted(good[:at] + good[at + count :])
        assert [reply.stamp_ms for reply in scans] == [777]


@pytest.mark.parametrize("garbage", [b"\x00", b"\xff", b"\x00\xff" * 500, b"\n", b"\n\n", b"MD00440725010"])
def test_garbage_inside_a_scan_costs_that_scan_only(garbage):
    good = scan()
    for at in (1, 14, 18, 23, 500, 2136):
        scans, _ = accepted(scan(1, 5) + good[:at] + garbage + good[at:])
        assert [reply.stamp_ms for reply in scans if reply.stamp_ms != 123_456] == [5, 777]


def test_a_lost_line_end_costs_one_scan():
    lines = scan().split(b"\n")
    for number in range(len(lines) - 2):
        merged = b"\n".join([*lines[:number], lines[number] + lines[number + 1], *lines[number + 2 :]])
        scans, _ = accepted(merged)
        assert [reply.stamp_ms for reply in scans] == [777], f"line {number}"


def test_a_truncated_scan_costs_itself_and_not_the_next():
    good = scan()
    for at in range(1, len(good) - 2, 19):
        scans, decoder = accepted(good[:at])
        assert [reply.stamp_ms for reply in scans] == [777], f"cut at {at}"
        assert decoder.skipped_bytes == at


def test_a_reply_after_a_scan_without_an_end_is_still_found():
    decoder = Decoder(REQUEST)
    assert decoder.feed(scan()[:1000] + b"\nQT\n00P\n\n") == [Reply(0, b"QT", b"00")]
    assert decoder.damaged == {"no end": 1}


def test_a_data_line_that_ends_like_an_echo_is_no_echo():
    # MS, one value left for the last line, and it is 0: its line reads 00P, as a good status does.
    request = StreamRequest(first_step=100, last_step=132, wide=False)
    numbers = [1000] * 31 + [0x21 * 64 + 0x24, 0]
    data = encode_scan(request.echo(0), b"99", 5, numbers, 2)
    assert b"QT" in data
    assert data.endswith(b"\n00P\n\n")
    damaged = b"x" + data[1:]
    assert Decoder(request).feed(damaged) == []


def test_the_scan_of_another_request_is_counted_as_foreign():
    other = StreamRequest(first_step=128, last_step=640)
    decoder = Decoder(REQUEST)
    assert decoder.feed(scan(0, 1, other)) == []
    assert decoder.foreign == 1
    assert decoder.damaged.total() == 0


@pytest.mark.parametrize("noise", [b"x" * 20_000, b"x\n" * 10_000, bytes(range(11, 256)) * 90])
def test_endless_noise_is_dropped_and_a_scan_behind_it_is_read(noise):
    decoder = Decoder(REQUEST)
    for at in range(0, len(noise), 100):
        decoder.feed(noise[at : at + 100])
        assert decoder.pending_bytes <= BUFFER_BYTES
    data = scan()
    found = [reply for at in range(0, len(data), 64) for reply in decoder.feed(data[at : at + 64])]
    assert [reply.stamp_ms for reply in found] == [123_456]
    assert decoder.skipped_bytes == len(noise)


def test_a_reset_drops_what_was_begun_and_counts_it():
    decoder = Decoder(REQUEST)
    decoder.feed(scan()[:50])
    decoder.reset()
    assert decoder.skipped_bytes == 50
    assert decoder.pending_bytes == 0
    assert len(decoder.feed(scan())) == 1


def test_what_was_wrong_is_counted_by_its_kind():
    decoder = Decoder(REQUEST)
    good = scan()
    replace = lambda at, byte: good[:at] + bytes((byte,)) + good[at + 1 :]  # noqa: E731
    decoder.feed(good[:30] + good[31:])
    decoder.feed(replace(20, good[20] ^ 1))
    decoder.feed(replace(40, 0x7F))
    decoder.feed(replace(40, good[40] ^ 1))
    decoder.feed(replace(91, 0x30))
    decoder.feed(b"noise\n\n")
    assert decoder.damaged == {"length": 1, "stamp": 1, "character": 1, "sum": 1, "line": 1, "echo": 1}


def test_a_line_of_information_with_a_wrong_sum_does_not_cost_the_reply():
    lines = [encode_information("PROD", "URG-04LX")[:-1] + b"!", b"without a tag"]
    (reply,) = Decoder().feed(encode_reply(b"VV", b"00", lines))
    assert reply.lines == tuple(lines)


def test_a_carriage_return_is_damage_and_no_line_end():
    assert Decoder().feed(b"QT\r\n00P\r\n\r\n") == []
    assert with_sum(b"00") == b"00P"
