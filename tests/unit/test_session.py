"""A session on disk: whole or refused, and its scans never lost."""

import numpy as np
import pytest

from runtime.cli import main
from runtime.formats.errors import FormatError
from runtime.formats.logs import open_log
from runtime.formats.mcap_log import McapChannel
from runtime.formats.mcap_writer import McapWriter
from runtime.formats.session import (
    FILE,
    FORMAT,
    RECORD,
    SUMS,
    CutSessionError,
    Parts,
    SessionWriter,
    read_session,
    scans_of,
)
from runtime.messages import LaserScan, encode, header

HEAD = {"version": "1.2", "seed": "7"}
PARTS = Parts(
    posterior={"path": np.arange(12.0).reshape(4, 3), "keys": np.arange(4)},
    config="slam: {}\n",
    trajectory=b"0.100000 0 0 0 0 0 0 1\n",
    picture=b"not looked at here",
    resolution_m=0.05,
    origin_m=(-1.1500000000000001, 2.0),
    layer={"paints": np.zeros(0, np.uint8)},
)


def payload(number):
    return encode(
        LaserScan(
            header=header(number * 10**8, "laser"), angle_min=-1.0, angle_max=1.0, angle_increment=0.02,
            time_increment=0.0, scan_time=0.1, range_min=0.02, range_max=30.0,
            ranges=np.full(101, 1.0 + 0.01 * number, dtype=np.float32), intensities=np.zeros(0, np.float32),
        )
    )  # fmt: skip


def written(path, scans=30, drive=1, parts=PARTS):
    writer = SessionWriter(path, HEAD)
    for number in range(1, scans + 1):
        writer.add(drive, number * 10**8, payload(number))
    writer.finish(parts)
    return path


def test_a_session_comes_back_as_it_was_written(tmp_path):
    session = read_session(written(tmp_path / "a.mcap"))
    assert (session.version, session.seed, session.drives) == ("1.2", 7, 1)
    for name, array in PARTS.posterior.items():
        assert np.array_equal(session.parts.posterior[name], array)
    assert session.parts.origin_m == PARTS.origin_m
    assert (session.parts.config, session.parts.picture) == (PARTS.config, PARTS.picture)
    assert [stamp for _, stamp, _ in scans_of(session.path)] == [n * 10**8 for n in range(1, 31)]


def test_a_results_folder_stands_for_the_session_in_it(tmp_path):
    written(tmp_path / FILE)
    assert read_session(tmp_path).path == tmp_path / FILE
    (tmp_path / FILE).unlink()
    with pytest.raises(FormatError, match=r"a folder without session\.mcap"):
        read_session(tmp_path)


def test_the_same_session_is_the_same_bytes(tmp_path):
    one, other = written(tmp_path / "a.mcap"), written(tmp_path / "b.mcap")
    assert one.read_bytes() == other.read_bytes()


def test_until_it_is_whole_it_does_not_have_its_name(tmp_path):
    writer = SessionWriter(tmp_path / "a.mcap", HEAD)
    writer.add(1, 1, payload(1))
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap.active"]
    writer.finish(PARTS)
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


def test_an_older_session_stays_until_the_new_one_is_whole(tmp_path):
    written(tmp_path / "a.mcap", scans=5)
    writer = SessionWriter(tmp_path / "a.mcap", HEAD)
    writer.copy(tmp_path / "a.mcap")
    assert len(list(scans_of(tmp_path / "a.mcap"))) == 5
    writer.add(2, 1, payload(1))
    writer.finish(PARTS)
    assert read_session(tmp_path / "a.mcap").drives == 2
    assert [drive for drive, _, _ in scans_of(tmp_path / "a.mcap")] == [1] * 5 + [2]


def test_its_scans_are_a_log(tmp_path):
    log = open_log(written(tmp_path / "a.mcap"))
    assert len(log) == 30
    assert log.run_seed == 7
    assert not log.losses
    assert next(iter(log)).ranges_m[0] == np.float32(1.01)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9, 0.999])
def test_a_cut_session_is_refused_and_says_what_can_still_be_done(tmp_path, share):
    whole = written(tmp_path / "a.mcap").read_bytes()
    (tmp_path / "b.mcap").write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(CutSessionError, match=r"b\.mcap: the file was cut; .* mapped again") as caught:
        read_session(tmp_path / "b.mcap")
    assert caught.value.exit_code == 4


def test_no_flipped_byte_gets_through(tmp_path):
    whole = bytearray(written(tmp_path / "a.mcap", scans=3).read_bytes())
    rng = np.random.default_rng(3)
    refused = 0
    for at in rng.choice(len(whole), 200, replace=False).tolist():
        damaged = whole.copy()
        damaged[at] ^= 0x55
        (tmp_path / "b.mcap").write_bytes(damaged)
        try:
            session = read_session(tmp_path / "b.mcap")
        except FormatError:
            refused += 1
            continue
        # What is read in spite of it is not what was hit.
        for name, array in PARTS.posterior.items():
            assert np.array_equal(session.parts.posterior[name], array)
        assert session.parts.config == PARTS.config
    assert refused > 20


def test_what_is_no_session_is_refused(tmp_path):
    (tmp_path / "text").write_text("hello")
    with pytest.raises(FormatError, match="no MCAP file") as caught:
        read_session(tmp_path / "text")
    assert caught.value.exit_code == 2
    recording = McapWriter(tmp_path / "r.mcap", {"hallway": HEAD})
    recording.add(McapChannel("/robot/scan", "sensor_msgs/msg/LaserScan"), 1, 1, 1, payload(1))
    recording.finish()
    with pytest.raises(FormatError, match="a recording and no session"):
        read_session(tmp_path / "r.mcap")


def test_another_format_is_refused_by_name(tmp_path):
    writer = McapWriter(tmp_path / "a.mcap", {"hallway": HEAD})
    writer.finish({RECORD: {"format": str(FORMAT + 1)}, SUMS: {}})
    with pytest.raises(
        FormatError, match=rf"format {FORMAT + 1}, written by hallway 1\.2, must be of format"
    ):
        read_session(tmp_path / "a.mcap")


def test_program_objects_are_never_read(tmp_path):
    parts = Parts(
        posterior={"path": np.array([{"a": 1}], dtype=object)}, config="", trajectory=b"", picture=b"",
        resolution_m=0.05, origin_m=(0.0, 0.0), layer={},
    )  # fmt: skip
    with pytest.raises(CutSessionError, match="posterior"):
        read_session(written(tmp_path / "a.mcap", parts=parts))


@pytest.mark.parametrize(
    ("name", "code", "said"),
    [
        ("empty.mcap", 2, "empty.mcap: no session: it is no MCAP file"),
        ("cut.mcap", 4, "cut.mcap: the file was cut"),
        ("folder", 2, "folder: a folder without session.mcap, must be a session or a results folder"),
        ("missing", 2, "missing: No such file or directory"),
    ],
)
def test_no_process_starts_on_what_is_no_session(name, code, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "folder").mkdir()
    whole = written(tmp_path / "cut.mcap")
    whole.write_bytes(whole.read_bytes()[:-500])
    before = sorted(tmp_path.iterdir())
    assert main(["up", "demo", "--headless", "--on", name]) == code
    assert capsys.readouterr().err.startswith(f"hallway up: {said}")
    assert sorted(tmp_path.iterdir()) == before
