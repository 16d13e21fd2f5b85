"""Whatever comes over the wire: the decoders never raise, never hoard, and lose only what was touched."""

from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from drivers.create import protocol, stream
from drivers.create.protocol import CommandDecoder
from drivers.create.stream import PACKETS, Rule, StreamDecoder

FRAME = stream.frame_bytes(PACKETS)

values = st.fixed_dictionaries(
    {
        7: st.integers(0, 31), 9: st.integers(0, 1), 12: st.integers(0, 1), 14: st.integers(0, 31),
        21: st.integers(0, 5), 22: st.integers(5000, 25000), 23: st.integers(-(2**15), 2**15 - 1),
        24: st.integers(-20, 80), 25: st.integers(0, 65535), 26: st.integers(0, 65535), 34: st.integers(0, 3),
        35: st.integers(0, 3), 41: st.integers(-500, 500), 42: st.integers(-500, 500),
    }
)  # fmt: skip
rules = st.sampled_from(list(Rule))


def chunked(data, cuts):
    edges = sorted({0, len(data), *(c % (len(data) + 1) for c in cuts)})
    return [data[a:b] for a, b in pairwise(edges)]


@given(st.lists(values, min_size=1, max_size=8), rules, st.lists(st.integers(0, 10_000), max_size=20))
def test_any_chunking_of_the_stream_gives_the_same_frames(frames, rule, cuts):
    wire = b"".join(stream.encode_frame(PACKETS, v, rule) for v in frames)
    whole = StreamDecoder().feed(wire)
    assert len(whole) == len(frames)
    assert [t.voltage_mv for t in whole] == [v[22] for v in frames]
    assert [(t.right_mmps, t.left_mmps) for t in whole] == [(v[41], v[42]) for v in frames]
    pieces, bytewise = StreamDecoder(), StreamDecoder()
    assert [t for piece in chunked(wire, cuts) for t in pieces.feed(piece)] == whole
    assert [t for i in range(len(wire)) for t in bytewise.feed(wire[i : i + 1])] == whole
    assert pieces.counters() == bytewise.counters()


@given(st.lists(st.binary(max_size=300), max_size=10))
def test_arbitrary_bytes_neither_raise_nor_pile_up(chunks):
    decoder, robot = StreamDecoder(), CommandDecoder()
    for chunk in chunks:
        decoder.feed(chunk)
        robot.feed(chunk)
        assert len(decoder._buffer) < FRAME
        assert len(robot._buffer) < 3 + 2 * 255


@given(values, rules, st.integers(0, FRAME - 1), st.integers(1, 255))
def test_a_flipped_byte_costs_its_frame_and_no_other(frame_values, rule, at, flip):
    good = stream.encode_frame(PACKETS, frame_values, rule)
    decoder = StreamDecoder()
    decoder.feed(good * stream.LATCH_FRAMES)
    bad = bytearray(good)
    bad[at] ^= flip
    assert len(decoder.feed(bytes(bad) + good * 3)) == 3


@given(values, rules, st.integers(0, FRAME - 1))
def test_a_lost_byte_costs_its_frame_and_at_most_one_more(frame_values, rule, at):
    good = stream.encode_frame(PACKETS, frame_values, rule)
    decoder = StreamDecoder()
    decoder.feed(good * stream.LATCH_FRAMES)
    assert len(decoder.feed(good[:at] + good[at + 1 :] + good * 3)) >= 2


@given(st.integers(-500, 500), st.integers(-500, 500), st.binary(max_size=3))
def test_a_drive_command_reaches_the_robot_behind_unknown_bytes(right, left, noise):
    robot = CommandDecoder()
    noise = bytes(b % 7 for b in noise)  # opcodes below 7 are unknown
    commands = robot.feed(noise + protocol.drive_direct(right, left))
    assert [c.wheels() for c in commands] == [(right, left)]


@given(st.floats(-2, 2), st.floats(-10, 10), st.floats(0.1, 0.5), st.floats(0.05, 0.5))
def test_wheels_never_exceed_the_limit_and_never_turn_the_other_way(v, w, base, limit):
    left, right = protocol.wheel_speeds(v, w, base, limit)
    assert max(abs(left), abs(right)) <= round(limit * 1000)
    assert (right - left) * w >= -1e-9
