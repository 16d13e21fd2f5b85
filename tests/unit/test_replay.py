"""Playing back: order and bytes of the file, the pace that was asked for, and nothing that moves a robot."""

import numpy as np
import pytest

from runtime.bus.memory import MemoryBus
from runtime.cli import replay, replay_map
from runtime.cli.replay_keys import obey
from runtime.errors import ConfigError
from runtime.formats.mcap_log import McapChannel
from runtime.formats.mcap_writer import McapWriter
from runtime.formats.tum import write_tum
from runtime.messages import DiagnosticArray, DiagnosticStatus, LaserScan, encode, header, topic_key
from runtime.nodes import player
from runtime.port import ListPort
from runtime.process.health import Health
from runtime.process.node import BusPort
from runtime.recordings.pace import Control
from runtime.recordings.replay import Recorded, ReplayConfig, in_name_of, play
from runtime.topics import TOPICS

S = 10**9
BEGAN = 1_700_000_000 * S


def scan(n):
    ranges = np.full(3, n, dtype=np.float32)
    arrays = ranges, np.zeros(0, np.float32)
    return encode(
        LaserScan(header(BEGAN + n * S // 10, "laser"), -1.0, 1.0, 1.0, 0.0, 0.1, 0.0, 99.0, *arrays)
    )


def write(path, rows, first=1, missing=()):
    """Write (topic, arrival, payload); scans numbered from `first` but those `missing`."""
    writer = McapWriter(path, {"hallway": {"robot": "robot"}})
    numbers = {}
    for name, log_ns, payload in rows:
        number = numbers.get(name, first - 1) + 1
        while name == "scan" and number in missing:
            number += 1
        numbers[name] = number
        channel = McapChannel(f"/robot/{name}", TOPICS[name].type, {"gid": "aa" + name})
        writer.add(channel, number, BEGAN + log_ns, BEGAN + log_ns, payload)
    writer.finish()
    return path


@pytest.fixture
def recording(tmp_path):
    rows = [("scan", n * S // 10, scan(n)) for n in range(20)]
    rows.insert(3, ("cmd_vel", 3 * S // 10, b"drive!"))
    rows.insert(9, ("battery", 9 * S // 10, b"low"))
    return write(tmp_path / "a.mcap", rows)


class Stage:
    """A present that moves only while somebody sleeps."""

    def __init__(self, config=None, **kwargs):
        self.config = config or ReplayConfig(**kwargs)
        self.now_ns = 5_000 * S
        self.control = Control()
        self.sent = []
        self.clock = []
        self.on_sleep = lambda: None

    def sleep(self, seconds):
        assert 0 < seconds <= 0.05
        self.now_ns += round(seconds * 1e9)
        self.on_sleep()

    def play(self, recorded):
        return play(
            recorded,
            self.config,
            self.control,
            lambda name, payload, *_: self.sent.append((self.now_ns, name, payload)),
            self.clock.append,
            now_ns=lambda: self.now_ns,
            sleep=self.sleep,
        )

    def run(self, *files):
        return self.play(Recorded(files, self.config))


def test_everything_is_played_in_order_byte_for_byte_but_what_moves_a_robot(recording):
    stage = Stage()
    played = stage.run(recording)
    sent = [("scan", scan(n)) for n in range(20)]
    sent.insert(8, ("battery", b"low"))
    assert [(name, payload) for _, name, payload in stage.sent] == sent
    assert played.messages == {"scan": 20, "battery": 1}
    assert played.complete
    assert played.scan_stamps_ns == [BEGAN + n * S // 10 for n in range(20)]


@pytest.mark.parametrize("rate", [0.5, 1.0, 4.0])
def test_the_pace_is_the_recorded_one_times_the_rate(recording, rate):
    stage = Stage(rate=rate, topics=("scan",))
    stage.run(recording)
    times = np.array([now for now, _, _ in stage.sent])
    np.testing.assert_allclose(times - times[0], np.arange(20) * 0.1 * S / rate, atol=1000)


def test_a_rate_of_zero_never_waits(recording):
    stage = Stage(rate=0.0)
    stage.run(recording)
    assert {now for now, _, _ in stage.sent} == {5_000 * S}


def test_the_recorded_time_is_told_twenty_times_a_second(recording):
    stage = Stage()
    stage.run(recording)
    told = np.array(stage.clock) - BEGAN
    assert told[0] == 0
    assert (np.diff(told) > 0).all()
    assert 38 <= len(told) <= 42  # 1.9 s


def test_a_part_is_played_by_recorded_time(recording):
    stage = Stage(start_s=0.5, duration_s=1.0, topics=("scan",))
    played = stage.run(recording)
    assert [payload for _, _, payload in stage.sent] == [scan(n) for n in range(5, 15)]
    assert played.complete


def test_a_loop_begins_again_at_once(recording):
    stage = Stage(loop=True, topics=("scan",))
    stage.control.stopping = lambda: len(stage.sent) == 50
    played = stage.run(recording)
    assert [payload for _, _, payload in stage.sent] == [scan(n % 20) for n in range(50)]
    assert not played.complete


def test_a_pause_takes_no_recorded_time(recording):
    stage = Stage(topics=("scan",))

    def pause_for_a_while():
        if len(stage.sent) == 5 and stage.now_ns < 5_003 * S:
            stage.control.paused = True
        elif stage.now_ns > 5_008 * S:
            stage.control.paused = False

    stage.on_sleep = pause_for_a_while
    played = stage.run(recording)
    gaps = np.diff([now for now, _, _ in stage.sent]) / 1e9
    assert np.argmax(gaps) == 4
    assert gaps[4] > 7.0
    np.testing.assert_allclose(np.delete(gaps, 4), 0.1, atol=0.06)
    assert played.complete


def test_steps_play_one_message_each_while_paused(recording):
    stage = Stage(topics=("scan",))
    stage.control.paused, stage.control.steps = True, 3
    stage.control.stopping = lambda: stage.now_ns > 5_010 * S
    stage.run(recording)
    assert [payload for _, _, payload in stage.sent] == [scan(0), scan(1), scan(2)]


def test_a_change_of_rate_holds_from_where_the_recording_is(recording):
    stage = Stage(topics=("scan",))

    def faster():
        if len(stage.sent) == 10:
            stage.control.rate = 10.0

    stage.on_sleep = faster
    stage.run(recording)
    gaps = np.diff([now for now, _, _ in stage.sent]) / 1e9
    np.testing.assert_allclose(gaps[:9], 0.1, atol=1e-6)
    np.testing.assert_allclose(gaps[10:], 0.01, atol=1e-6)


def test_the_keys_mean_what_the_help_says():
    control = Control()
    assert obey(" ", control)
    assert control.paused
    assert obey("s", control)
    assert (control.paused, control.steps) == (True, 1)
    assert obey("+", control)
    assert obey("+", control)
    assert obey("-", control)
    assert control.rate == 2.0
    assert not obey("q", control)


def test_what_is_said_at_the_end_stands_on_a_line_of_its_own(recording, monkeypatch, capsys):
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    line = replay._Screen(Recorded([recording], ReplayConfig()), Control(), quiet=False)
    line.show(0)
    assert capsys.readouterr().err.endswith(" s, 1 x")
    line.clear()
    assert capsys.readouterr().err == "\r\x1b[K"


def test_parts_of_one_recording_are_played_one_after_the_other(tmp_path):
    a = write(tmp_path / "a_000.mcap", [("scan", n * S // 10, scan(n)) for n in range(3)])
    b = write(tmp_path / "a_001.mcap", [("scan", n * S // 10, scan(n)) for n in range(3, 6)], first=4)
    stage = Stage()
    stage.run(a, b)
    times = np.array([now for now, _, _ in stage.sent])
    np.testing.assert_allclose(np.diff(times), 0.1 * S, atol=1000)
    assert [payload for _, _, payload in stage.sent] == [scan(n) for n in range(6)]


def test_what_moves_a_robot_is_played_when_it_is_asked_for(recording):
    stage = Stage(topics=("cmd_vel",))
    stage.run(recording)
    assert [(name, payload) for _, name, payload in stage.sent] == [("cmd_vel", b"drive!")]


def test_a_cut_recording_is_played_as_far_as_it_goes_and_says_so(recording, tmp_path):
    whole = Recorded([recording], ReplayConfig())
    assert len(list(whole.messages())) == 21
    assert whole.losses() == []
    cut = tmp_path / "c.mcap"
    writer = McapWriter(cut)
    writer.add(McapChannel("/robot/scan", TOPICS["scan"].type, {}), 1, BEGAN, 0, scan(0))
    writer.flush()
    writer.abandon()
    recorded = Recorded([tmp_path / "c.mcap.active"], ReplayConfig())
    assert len(list(recorded.messages())) == 1
    assert "c.mcap.active: the file was cut" in recorded.losses()[0]


@pytest.mark.parametrize(
    ("config", "said"),
    [
        ({"topics": ("map",)}, "topic 'map': not recorded; there are battery, cmd_vel, scan"),
        ({"start_s": 10.0}, "start_s = 10.0, the recording lasts 1.900 s"),
    ],
)
def test_what_is_not_there_cannot_be_played(recording, config, said):
    with pytest.raises(ConfigError, match=said):
        Recorded([recording], ReplayConfig(**config))


@pytest.mark.parametrize(
    "config",
    [{"rate": -1.0}, {"rate": 1000.0}, {"start_s": -1.0}, {"start_s": np.nan}, {"duration_s": np.inf}],
)
def test_a_wrong_configuration_is_refused(config):
    with pytest.raises(ValueError, match=next(iter(config))):
        ReplayConfig(**config)


# ---- what is missing ----


def numbers_heard(path, **config):
    """Play onto a bus; return (publisher, number) of each scan, and what was played."""
    bus = MemoryBus()
    heard = []
    bus.subscribe(
        topic_key("robot/scan", TOPICS["scan"].type), lambda arrival: heard.append(arrival.attachment)
    )
    config = ReplayConfig(rate=0.0, **config)
    recorded = Recorded([path], config)
    control = Control()
    with BusPort("player", bus.join, publishes=("scan",)) as port:
        control.stopping = lambda: len(heard) >= 30
        play(recorded, config, control, port.publish_raw, lambda now_ns: None)
        assert int(port.counters()["scan.published"]) == len(heard)
    return [(one.gid, one.sequence) for one in heard], recorded


def test_the_numbers_that_listeners_see_have_the_hole_of_the_recording(tmp_path):
    rows = [("scan", n * S // 10, scan(n)) for n in range(20)]
    path = write(tmp_path / "a.mcap", rows, first=101, missing=range(106, 116))
    heard, recorded = numbers_heard(path)
    # 1 .. 5, and on after ten that are not there.
    assert [number for _, number in heard] == [*range(1, 6), *range(16, 31)]
    assert len({gid for gid, _ in heard}) == 1
    assert recorded.losses() == ["10 messages of /robot/scan, by its sequence numbers"]
    assert recorded.gaps() == [{"topic": "/robot/scan", "at_s": 0.5, "first": 106, "count": 10}]


def unnumbered(path, numbers, others=()):
    """Write scans without numbers of these tenths of a second, and (topic, tenth) beside them."""
    writer = McapWriter(path)
    rows = [("scan", n) for n in numbers] + list(others)
    for name, n in sorted(rows, key=lambda row: row[1]):
        payload = scan(n) if name == "scan" else b"low"
        at_ns = BEGAN + round(n * S / 10)
        writer.add(McapChannel(f"/robot/{name}", TOPICS[name].type, {}), 0, at_ns, at_ns, payload)
    writer.finish()
    return path


def test_scans_without_numbers_get_the_hole_that_their_stamps_tell(tmp_path):
    path = unnumbered(tmp_path / "a.mcap", [*range(10), *range(14, 34)])
    heard, recorded = numbers_heard(path)
    assert [number for _, number in heard] == [*range(1, 11), *range(15, 35)]
    assert recorded.losses() == recorded.gaps() == []  # without numbers nobody knows


def test_who_waits_for_the_stamps_behind_a_hole_plays_in_order_and_all_of_it(tmp_path):
    others = [("battery", n + 0.5) for n in range(0, 40, 5)]
    path = unnumbered(tmp_path / "a.mcap", [*range(10), *range(14, 40)], others)
    stage = Stage()
    played = stage.run(path)
    assert played.messages == {"scan": 36, "battery": 8}
    assert played.scan_stamps_ns == [BEGAN + n * S // 10 for n in (*range(10), *range(14, 40))]
    times = [now for now, _, _ in stage.sent]
    assert times == sorted(times)
    assert times[-1] - times[0] == pytest.approx(3.9 * S, abs=1000)


def test_scans_that_tell_neither_number_nor_rate_are_played_one_by_one(tmp_path):
    writer = McapWriter(tmp_path / "a.mcap")
    for n, payload in enumerate((b"damaged", scan(0), scan(1), b"")):
        writer.add(McapChannel("/robot/scan", TOPICS["scan"].type, {}), 0, BEGAN + n, BEGAN + n, payload)
    writer.finish()
    heard, _ = numbers_heard(tmp_path / "a.mcap")
    assert [number for _, number in heard] == [1, 2, 3, 4]


def test_what_lies_outside_of_the_played_part_is_not_missing_from_it(tmp_path):
    rows = [("scan", n * S // 10, scan(n)) for n in range(20)]
    path = write(tmp_path / "a.mcap", rows, missing=range(6, 16))
    for config in ({"start_s": 0.5}, {"duration_s": 0.5}):
        heard, recorded = numbers_heard(path, **config)
        assert [number for _, number in heard] == list(range(1, len(heard) + 1))
        assert recorded.losses() == recorded.gaps() == []
    assert numbers_heard(path, start_s=0.3, duration_s=0.4)[1].gaps()[0]["count"] == 10


def test_the_begin_of_a_loop_is_no_hole_and_no_message_from_before(recording):
    heard, recorded = numbers_heard(recording, loop=True, topics=("scan",))
    assert [number for _, number in heard] == list(range(1, 31))
    assert recorded.losses() == []


def test_each_publisher_of_the_recording_is_heard_as_one_of_its_own(tmp_path):
    writer = McapWriter(tmp_path / "a.mcap")
    for n, gid in ((1, "aa"), (2, "aa"), (1, "bb"), (2, "bb")):
        at_ns = BEGAN + (n + 13 * (gid == "bb")) * S // 10
        writer.add(McapChannel("/robot/scan", TOPICS["scan"].type, {"gid": gid}), n, at_ns, at_ns, scan(n))
    writer.finish()
    heard, recorded = numbers_heard(tmp_path / "a.mcap")
    assert [number for _, number in heard] == [1, 2, 1, 2]
    assert heard[0][0] == heard[1][0] != heard[2][0] == heard[3][0]
    assert recorded.outages() == ["1.300 s: /robot/scan: a new publisher after 1.2 s without one"]


def test_scans_that_were_sent_and_are_not_in_the_map_are_told_beside_those_that_never_came(tmp_path, capsys):
    path = write(
        tmp_path / "a.mcap", [("scan", n * S // 10, scan(n)) for n in range(20)], missing=range(6, 16)
    )
    stamps_ns = np.array([BEGAN + n * S // 10 for n in range(20)])
    out = tmp_path / "out"
    port = ListPort(stop_after=10**9, results_dir=out)
    port.MAX_IDLE_WAITS = 3
    player.run(port, player.Config(file=str(path), replay=ReplayConfig(rate=0.0, topics=("scan",))))
    recorded = Recorded([path], ReplayConfig(topics=("scan",)))
    write_tum(out / "trajectory.tum", stamps_ns, np.zeros((20, 3)))
    assert replay_map._report(out, recorded, 0, as_json=False) == 4
    told = capsys.readouterr()
    assert told.out.splitlines() == [
        f"{out}/: 20 of 20 scans mapped",
        "not in the recording              time s    first   count",
        "/robot/scan                        0.500        6      10",
    ]
    assert told.err == "hallway replay: 10 messages of /robot/scan, by its sequence numbers\n"
    # Scans 8 and 9 and the last one gave way on their way.
    write_tum(out / "trajectory.tum", np.delete(stamps_ns, (7, 8, 19)), np.zeros((17, 3)))
    assert replay_map._report(out, recorded, 0, as_json=False) == 4
    assert capsys.readouterr().out.splitlines()[3:] == [
        "sent, and not in the map          time s    first   count",
        "scan                               0.700        8       2",
        "scan                               1.900       20       1",
    ]


def test_the_processes_of_a_robot_that_is_played_as_another_are_the_others(tmp_path):
    status = DiagnosticStatus(level=1, name="robot/matcher", message="m", hardware_id="h", values=[])
    payload = encode(DiagnosticArray(header=header(BEGAN, ""), status=[status]))
    bus = MemoryBus()
    health = Health(bus, "bob")
    with BusPort("player", bus.join, publishes=("diagnostics",), robot="bob") as port:
        port.publish_raw("diagnostics", payload)
        assert "matcher" not in health.vitals()
        port.publish_raw("diagnostics", in_name_of("bob", payload))
        vital = health.vitals()["matcher"]
    assert (vital.level, vital.text, vital.stamp_ns) == ("warn", "m", BEGAN)
    assert in_name_of("robot", payload) == payload
    assert in_name_of("bob", b"rubbish") == b"rubbish"


# ---- the player process ----


def test_the_player_sends_the_scans_and_waits_for_the_last_pose(recording, tmp_path):
    port = ListPort(stop_after=10**9, results_dir=tmp_path / "out")
    config = player.Config(file=str(recording), replay=ReplayConfig(rate=0.0, topics=("scan",)))
    port.MAX_IDLE_WAITS = 3  # nobody answers: the wait for the last pose must end
    assert player.run(port, config) == 0
    assert [payload for name, payload in port.published if name == "scan"] == [scan(n) for n in range(20)]
    assert (tmp_path / "out" / "played.json").is_file()


@pytest.mark.parametrize(
    ("topics", "said"), [(("odom",), "'odom' is none of scan, truth"), ((), "must name at least one")]
)
def test_the_player_speaks_for_sensors_only(topics, said):
    with pytest.raises(ValueError, match=said):
        player.Config(file="a.mcap", replay=ReplayConfig(topics=topics))
