"""Whatever happens to the bytes of a recording, reading it raises nothing and invents nothing."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from runtime.formats.mcap_log import MAGIC, McapChannel, McapReader
from runtime.formats.mcap_writer import McapWriter
from runtime.formats.missing import Account

CHANNEL = McapChannel("/robot/bumper", "std_msgs/msg/UInt8", {"gid": "aa"})
many = settings(max_examples=300, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])


def payload(n):
    return b"\x00\x01\x00\x00" + n.to_bytes(4, "little") * 8


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    path = tmp_path_factory.mktemp("whole") / "a.mcap"
    writer = McapWriter(path, {"hallway": {"seed": "1"}}, {"config.yaml": b"x: 1\n"})
    for n in range(1, 31):
        writer.add(CHANNEL, n, n, n, payload(n))
        if n % 5 == 0:
            writer.flush()
    writer.finish()
    return path.read_bytes()


def read(tmp_path, data):
    (tmp_path / "a.mcap").write_bytes(data)
    reader = McapReader(tmp_path / "a.mcap")
    return list(reader.messages()), reader.state


@many
@given(changes=st.lists(st.tuples(st.floats(0, 1), st.integers(1, 255)), min_size=1, max_size=4))
def test_flipped_bytes_cost_messages_and_never_change_them(tmp_path, whole, changes):
    data = bytearray(whole)
    for place, flip in changes:
        at = len(MAGIC) + int(place * (len(data) - len(MAGIC) - 1))
        data[at] ^= flip
    messages, _ = read(tmp_path, data)
    for message in messages:
        if message.channel.msgtype == CHANNEL.msgtype:  # the name of a channel may be what was hit
            assert message.payload == payload(message.sequence)


@many
@given(tail=st.binary(max_size=200), keep=st.floats(0, 1))
def test_a_cut_followed_by_rubbish_keeps_what_was_whole(tmp_path, whole, tail, keep):
    cut = len(MAGIC) + int(keep * (len(whole) - len(MAGIC)))
    kept = [message.sequence for message in read(tmp_path, whole[:cut])[0]]
    messages, _ = read(tmp_path, whole[:cut] + tail)
    assert [message.sequence for message in messages][: len(kept)] == kept


@given(numbers=st.lists(st.integers(1, 1000), min_size=1, max_size=60, unique=True).map(sorted))
def test_gaps_are_what_is_missing_between_the_first_and_the_last(tmp_path_factory, numbers):
    path = tmp_path_factory.mktemp("gaps") / "a.mcap"
    writer = McapWriter(path)
    for n in numbers:
        writer.add(CHANNEL, n, n, n, b"")
    writer.finish()
    account = Account()
    before = [account.see(message) for message in McapReader(path).messages()]
    expected = numbers[-1] - numbers[0] + 1 - len(numbers)
    assert account.missing(CHANNEL.topic) == sum(before) == expected
    assert sum(hole.count for hole in account.holes) == expected
