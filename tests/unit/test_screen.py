"""The live table of a robot, frame by frame."""

import io
import sys

import pytest
from rich.console import Console

from runtime import latency
from runtime.bus.offset import Offset
from runtime.cli.screen import Screen, table
from runtime.process.status import ProcessLine, Status

HOPS = {"match": {"p50": 3.0, "p99": 8.0, "max": 9.0}}


def status(hops_ms, map_size="", processes=(), clock=None):
    rates = {"scan": 10.0}
    return Status(
        robot="robot",
        tracking="TRACKING",
        map_size=map_size,
        scans=5,
        mapped=5,
        rates_hz=rates,
        hops_ms=hops_ms,
        processes=processes,
        clock=clock,
    )


def process(name, level="ok", text="", state="running", **counts):
    none = {"restarts": 0, "lost": 0, "duplicates": 0, "deadline_misses": 0}
    figures = {"pid": 7, "cpu_percent": 3.0, "rss_mb": 242.0, "queue_ms": 53.4}
    return ProcessLine(name=name, state=state, level=level, text=text, **figures, **(none | counts))


def painted(shown, width):
    console = Console(record=True, width=width, file=io.StringIO())
    console.print(table(shown, 5.0))
    return [line.rstrip() for line in console.export_text().splitlines()]


class Frames(list):
    """Stands in for rich's live display, and keeps what it was given as text."""

    def __call__(self, **options):
        return self

    def __init__(self):
        super().__init__()
        self.console, self.lines = self, []

    def print(self, line, **options):
        self.lines.append(line)

    def start(self):
        pass

    def stop(self):
        pass

    def update(self, renderable, refresh):
        console = Console(width=120, record=True, file=io.StringIO())
        console.print(renderable)
        self.append(console.export_text())


@pytest.fixture
def frames(monkeypatch):
    shown = Frames()
    monkeypatch.setattr("rich.live.Live", shown)
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setattr("runtime.cli.screen._PAINT_EVERY_S", 0.0)
    return shown


def test_the_last_frame_keeps_the_hops_that_whoever_measures_them_told_before_it_left(frames):
    with Screen() as screen:
        screen.show(status(HOPS), 1.0)
        screen.show(status({}), 2.0)
    assert len(frames) == 2
    assert all("scan published to odom published" in frame and "8.0" in frame for frame in frames)


def test_the_last_frame_keeps_the_size_of_the_map_that_the_mapper_told_before_it_saved_it(frames):
    with Screen() as screen:
        screen.show(status({}, map_size="6.2 m x 8.3 m"), 1.0)
        screen.show(status({}), 2.0)
    assert ["map 6.2 m x 8.3 m" in frame for frame in frames] == [True, True]


def test_the_table_shows_what_was_lost_came_twice_and_waited():
    laser = process("laser", lost=31, duplicates=42, deadline_misses=64, text="streaming")
    lines = painted(status({}, processes=(laser,), clock=Offset(-2_500_000, 400_000)), 200)
    assert lines[-3].split() == ["process", "cpu", "%", "MB", "queue", "ms"]
    assert lines[-1].strip() == "clock of the robot minus ours: -2.500 ms ± 0.200 ms"
    assert lines[-2].split(maxsplit=4) == ["laser", "3", "242", "53", "lost 31, twice 42, late 64, streaming"]


@pytest.mark.parametrize(
    ("state", "text", "words"),
    [
        ("starting", "running", "starting"),
        ("running", "running", "running"),
        ("running", "", "running"),
        ("running", "mapping", "mapping"),
        ("stopping", "saving the map", "stopping, saving the map"),
    ],
)
def test_a_process_is_said_to_be_in_one_state(state, text, words):
    lines = painted(status({}, processes=(process("mapper", state=state, text=text),)), 80)
    assert lines[-1].split(maxsplit=4) == ["mapper", "3", "242", "53", words]


def test_an_eighty_column_terminal_holds_a_robot_a_line_each_and_what_is_wrong_in_whole():
    cause = (
        "poses are late: p99 282 ms, limit 200 ms, most of it in the mapper: fewer mapper.mapping.particles"
    )
    where = "/tmp/hallway-0/robot_of_mine/devices/laser streaming"
    calm = [process(f"pretrigger{n}", text=where) for n in "1234567"]
    wrong = process("monitor", "warn", cause), process("base", "error", "port gone", "backoff", restarts=2)
    processes = (*calm, *wrong)
    lines = painted(status(dict.fromkeys(latency.HOPS, HOPS["match"]), processes=processes), 80)
    assert sum(line.endswith((" published", " drawn")) for line in lines) == len(latency.HOPS)
    assert len(lines) <= 23  # with the cursor's line, of the 24 that terminals begin with
    rows = [line for line in lines if line.startswith("pretrigger")]
    assert [row.split()[0] for row in rows] == [f"pretrigger{n}" for n in "1234567"]
    assert all(" 242 " in row and row.endswith("…") for row in rows)
    assert cause in " ".join(lines)
    assert lines[-1] == "base: port gone"
    assert "backoff, restarts 2" in "\n".join(lines)


def test_what_the_table_shows_is_no_line_beside_it(frames):
    with Screen() as screen:
        screen.say("mapper: ready", ordinary=True)
        screen.say("mapper: killed by signal 9, starts again")
    assert frames.lines == ["mapper: killed by signal 9, starts again"]


def test_without_a_terminal_every_line_is_said(capsys):
    with Screen() as screen:
        screen.say("mapper: ready", ordinary=True)
        screen.say("mapper: failed")
    assert capsys.readouterr().out == "mapper: ready\nmapper: failed\n"


def test_a_warning_that_stays_is_said_once_and_then_counted(monkeypatch, capsys):
    monkeypatch.setattr("runtime.cli.screen._PLAIN_EVERY_S", 0.0)

    def late(text):
        return status({}, processes=(process("monitor", "warn", text), process("laser", text="fine")))

    with Screen() as screen:
        for p99_ms in (215, 292, 234):
            screen.show(late(f"poses are late: p99 {p99_ms} ms"), 5.0)
        screen.show(late("poses are late: p99 7.5 ms"), 5.0)
        screen.show(late("the clock has stepped"), 5.0)
        screen.show(status({}), 5.0)
        screen.show(late("the clock has stepped"), 5.0)
    ends = [line.partition("scans")[2] for line in capsys.readouterr().out.splitlines()]
    assert ends == [
        " | monitor: poses are late: p99 215 ms",
        " | monitor: the same, 2 times",
        " | monitor: the same, 3 times",
        " | monitor: the same, 4 times",
        " | monitor: the clock has stepped",
        "",
        " | monitor: the clock has stepped",
    ]


class Unread(io.StringIO):
    """A pipe whose reader has ended."""

    def flush(self):
        raise BrokenPipeError(32, "Broken pipe")


def test_nobody_who_reads_is_no_reason_to_fall(monkeypatch):
    with Screen() as screen:
        screen.say("read")
        assert not screen.unread
        monkeypatch.setattr(sys, "stdout", Unread())
        screen.say("not read")
        assert screen.unread
        screen.show(status({}), 1.0)
        with pytest.raises(BrokenPipeError):
            screen.check_read()
