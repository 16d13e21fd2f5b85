"""What a file tells without being read through, and where reading may begin."""

import numpy as np
import pytest

from runtime.formats import mcap_log
from runtime.formats.errors import FormatError
from runtime.formats.mcap_index import McapIndex
from runtime.formats.mcap_log import McapChannel, McapReader
from runtime.formats.mcap_writer import McapWriter
from runtime.recordings.replay import Recorded, ReplayConfig
from runtime.topics import TOPICS

S = 10**9
SCAN = McapChannel("/robot/scan", TOPICS["scan"].type, {"gid": "aa"})
ODOM = McapChannel("/robot/odom", TOPICS["odom"].type, {"gid": "bb"})
CHUNKS, EACH = 8, 5


def write(path):
    """Write chunks of scans, one a second, some in disorder, and in the first chunk one odometry."""
    writer = McapWriter(path, {"hallway": {"seed": "7"}}, {"config.yaml": b"a: 1"})
    writer.add(ODOM, 1, 2 * S, 2 * S, b"odom")
    for chunk in range(CHUNKS):
        for n in range(chunk * EACH, (chunk + 1) * EACH):
            # The first of a chunk arrived before the last of the chunk before.
            at_ns = (n + 1) * S - (3 * S // 2 if chunk and n % EACH == 0 else 0)
            writer.add(SCAN, n + 1, at_ns, at_ns, b"scan%d" % n)
        writer.flush()
    return writer


@pytest.fixture
def whole(tmp_path):
    write(tmp_path / "a.mcap").finish({"hallway.end": {"ended": "as asked"}})
    return tmp_path / "a.mcap"


@pytest.fixture
def opened(monkeypatch):
    """Counts the chunks that are unpacked."""
    counts = []
    unpack = mcap_log.breakup_chunk
    monkeypatch.setattr(mcap_log, "breakup_chunk", lambda *a, **k: counts.append(1) or unpack(*a, **k))
    return counts


def told(path):
    index = McapIndex.of(path)
    channels = {(one.topic, one.msgtype, one.publisher) for one in index.channels.values()}
    return channels, index.began_ns, index.ended_ns, dict(index.attachments)


def test_the_index_tells_what_the_whole_file_tells(whole, tmp_path, opened):
    answer = told(whole)
    assert not opened
    assert answer[1:] == (S, CHUNKS * EACH * S, {"config.yaml": b"a: 1"})
    write(tmp_path / "b.mcap").abandon()
    assert told(tmp_path / "b.mcap.active") == answer
    assert len(opened) == CHUNKS
    metadata = McapIndex.of(whole).metadata
    reader = McapReader(whole)
    list(reader.messages())
    assert metadata == reader.state.metadata
    assert metadata.keys() == {"hallway", "hallway.end"}


def test_whatever_the_start_nothing_that_is_late_enough_is_left_out(whole):
    everything = list(McapReader(whole).messages())
    index = McapIndex.of(whole)
    for from_ns in np.arange(0, (CHUNKS * EACH + 2) * S, S // 2).tolist():
        late = [m.payload for m in everything if m.log_ns >= from_ns]
        found = list(McapReader(whole).messages(index.entry(from_ns)))
        assert [m.payload for m in found if m.log_ns >= from_ns] == late
        assert {m.channel for m in found} <= {m.channel for m in everything}


def test_a_start_in_the_middle_unpacks_nothing_of_what_lies_before(whole, opened):
    recorded = Recorded([whole], ReplayConfig(start_s=(CHUNKS - 2) * EACH + 1.0, topics=("scan",)))
    assert not opened  # before the first message
    played = [message.sequence for message, _ in recorded.messages()]
    assert played[0] == (CHUNKS - 2) * EACH + 2
    assert len(opened) == 2


def test_a_damaged_index_is_not_believed(whole, tmp_path):
    data = whole.read_bytes()
    answer, places = told(whole), range(data.rindex(b"/robot/scan"), len(data) - len(mcap_log.MAGIC))
    for place in places[:: len(places) // 40]:
        damaged = bytearray(data)
        damaged[place] ^= 0x20
        (tmp_path / "b.mcap").write_bytes(damaged)
        assert told(tmp_path / "b.mcap") == answer


def test_another_file_is_refused(tmp_path):
    (tmp_path / "c.mcap").write_bytes(b"no recording at all" * 10 + mcap_log.MAGIC)
    with pytest.raises(FormatError, match="not an MCAP file"):
        McapIndex.of(tmp_path / "c.mcap")
