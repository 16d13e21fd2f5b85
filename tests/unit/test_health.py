"""What processes say of themselves becomes one picture, and no foreign word can grow or break it."""

import io
import time

import pytest
from rich.console import Console

from runtime import messages
from runtime.bus.memory import MemoryBus
from runtime.bus.offset import Offset
from runtime.cli.screen import table
from runtime.messages import Attachment
from runtime.process.health import Health
from runtime.process.node import BusPort
from runtime.process.status import status_of
from runtime.topics import topic

KEY = messages.topic_key("robot/diagnostics", topic("diagnostics").type)


@pytest.fixture
def bus():
    with MemoryBus() as first:
        yield first


@pytest.fixture
def health(bus):
    return Health(bus, "robot")


def say(bus, name, level=0, text="", **values):
    pairs = [messages.KeyValue(key=key, value=str(value)) for key, value in values.items()]
    status = messages.DiagnosticStatus(level=level, name=name, message=text, hardware_id="", values=pairs)
    array = messages.DiagnosticArray(header=messages.header(5, ""), status=[status])
    bus.publisher(KEY).put(messages.encode(array), Attachment(1, 0, name.encode().ljust(16)[:16]).encode())


def test_the_last_word_of_each_process_is_kept(bus, health):
    say(bus, "robot/laser", 0, "good", rate=10)
    say(bus, "robot/laser", 1, "dusty", rate=9.5)
    vital = health.vitals()["laser"]
    assert (vital.level, vital.text, vital.number("rate"), vital.stamp_ns) == ("warn", "dusty", 9.5, 5)
    assert vital.number("nothing", -1.0) == -1.0
    assert vital.age_s < 5


def test_other_robots_and_garbage_are_let_pass(bus, health):
    say(bus, "other/laser", 0, "good")
    bus.publisher(KEY).put(b"garbage", b"")
    say(bus, "robot/laser", 77, "a level that is none")
    assert list(health.vitals()) == ["laser"]
    assert health.vitals()["laser"].level == "stale"
    assert health.undecodable == 1


def test_a_flood_of_names_does_not_grow_it(bus, health):
    for number in range(400):
        say(bus, f"robot/n{number}")
    assert len(health.vitals()) == 256


def test_silence_is_told_after_its_time_and_never_of_those_who_never_spoke(bus, health):
    say(bus, "robot/laser")
    assert health.silent(5.0) == set()
    assert health.silent(-1.0) == {"laser"}


def test_a_loop_that_hangs_is_told_though_its_process_speaks(bus, health):
    say(bus, "robot/supervisor", **{"child.mapper.state": "running", "child.matcher.state": "starting"})
    say(bus, "robot/mapper", 0, "mapping", ready=1, loop_age_s=7.2)
    say(bus, "robot/matcher", 0, "starting", ready=0, loop_age_s=50.0)
    assert health.loop_ages_s() == {"supervisor": 0.0, "mapper": 7.2, "matcher": 50.0}
    lines = lines_of(health)
    assert (lines["mapper"].level, lines["mapper"].text) == ("stale", "its loop has not turned for 7 s")
    assert lines["matcher"].level == "ok"
    say(bus, "robot/mapper", 0, "mapping", ready=1, loop_age_s=0.4)
    assert lines_of(health)["mapper"].level == "ok"


def test_a_token_that_outlives_its_process_does_not_make_the_next_one_ready(bus, health):
    old, new = bus.join(), bus.join()
    old.token(messages.node_token(old.zid, "robot", "laser"))
    assert health.ready() == {"laser"}
    health.forget("laser")
    assert health.ready() == set()
    new.token(messages.node_token(new.zid, "robot", "laser"))
    old.close()
    assert health.ready() == {"laser"}


def test_the_status_is_what_the_processes_said(bus, health):
    say(bus, "robot/matcher", 0, "fine", state="TRACKING", pid=7)
    say(
        bus,
        "robot/monitor",
        0,
        "used 9 of 10 scans",
        **{
            "scan.rate_hz": 10,
            "latency.whole.p50_ms": 120,
            "latency.whole.p99_ms": 140,
            "latency.whole.max_ms": 150,
        },
        scans=10,
        mapped=9,
    )
    say(bus, "robot/mapper", 0, "mapping", map_size="10.0 m x 5.0 m")
    say(bus, "robot/view_9", 0, "showing", **{"latency.screen.p50_ms": 150, "latency.screen.p99_ms": 170})
    say(
        bus,
        "robot/laser",
        1,
        "dusty",
        **{"scan.overwritten": 2, "odom.missed": 3, "scan.deadline_misses": 4},
        **{"scan.queue_ms": 2.5, "odom.queue_ms": 7.25, "scan.duplicates": 6, "odom.duplicates": 1},
    )
    say(
        bus,
        "robot/supervisor",
        0,
        "",
        **{
            "child.hub.state": "running",
            "child.hub.pid": 11,
            "child.hub.rss_mb": 51.5,
            "child.hub.cpu_percent": 1.5,
            "child.laser.state": "running",
            "child.laser.restarts": 2,
            "child.mapper.state": "backoff",
            "child.mapper.reason": "killed",
        },
    )
    status = status_of("robot", health.vitals())
    assert status.tracking == "TRACKING"
    assert (status.scans, status.mapped, status.map_size) == (10, 9, "10.0 m x 5.0 m")
    assert status.hops_ms == {
        "whole": {"p50": 120.0, "p99": 140.0, "max": 150.0},
        "screen": {"p50": 150.0, "p99": 170.0, "max": 0.0},
    }
    lines = {line.name: line for line in status.processes}
    assert list(lines)[:3] == ["hub", "laser", "mapper"]
    assert (lines["laser"].restarts, lines["laser"].lost, lines["laser"].deadline_misses) == (2, 5, 4)
    assert (lines["laser"].queue_ms, lines["laser"].duplicates) == (7.25, 7)
    assert (lines["hub"].pid, lines["hub"].rss_mb, lines["hub"].cpu_percent) == (11, 51.5, 1.5)
    assert (lines["mapper"].level, lines["mapper"].text) == ("error", "killed")
    assert "TRACKING" in status.line()
    assert status.troubles()["laser"] == "dusty"
    assert "ray to pose 120/140 ms" in status.line()


def test_how_far_the_clocks_are_apart_is_in_every_form_of_the_status(bus, health):
    status = status_of("robot", health.vitals(), Offset(-2_500_000, 400_000))
    assert "clock -2.500 ms ± 0.200 ms" in status.line()
    values = status.to_json()
    assert (values["clock_offset_ns"], values["clock_round_trip_ns"]) == (-2_500_000, 400_000)
    assert status_of("robot", {}).to_json()["clock_offset_ns"] is None


def test_an_empty_picture_is_one_too():
    status = status_of("robot", {})
    assert (status.tracking, status.processes, status.line()) == ("", (), "starting")


def test_a_real_port_is_heard(bus, health):
    with BusPort("mapper", bus.join) as port:
        port.report("warn", "full")
        port.ready()
        line = status_of("robot", health.vitals()).processes[0]
        assert (line.name, line.level, line.text, line.state) == ("mapper", "warn", "full", "running")
        assert line.rss_mb > 1


def test_a_guest_that_left_is_no_fault_and_a_silent_process_of_the_run_is_one(bus, health, monkeypatch):
    say(bus, "robot/supervisor", **{"child.laser.state": "running"})
    say(bus, "robot/laser", 0, "scanning")
    with BusPort("view_17", bus.join) as viewer:
        viewer.report("error", "the window was closed")
        viewer.ready()
        assert "view_17" in names(health)
    assert names(health) == ["laser", "supervisor"]  # it said so
    say(bus, "robot/view_18", 0, "showing")  # and this one is cut off without a word
    say(bus, "robot/record_19", 0, "recording", leaving=1)
    assert names(health) == ["laser", "supervisor", "view_18"]
    later(monkeypatch, 10.0)
    lines = {line.name: line for line in status_of("robot", health.vitals()).processes}
    assert list(lines) == ["laser", "supervisor"]
    assert [line.level for line in lines.values()] == ["stale", "stale"]


def test_what_runs_on_another_machine_is_in_the_list_whether_that_is_heard_or_not(bus, health, monkeypatch):
    expected = {"child.matcher.state": "elsewhere", "child.matcher.host": "desk"}
    say(bus, "robot/supervisor", **{"child.hub.state": "running", "child.hub.pid": 4, **expected})
    line = lines_of(health)["matcher"]
    assert (line.level, line.text, line.state, line.host) == ("stale", "not heard yet", "elsewhere", "desk")
    theirs = {"child.matcher.state": "running", "child.matcher.restarts": 2, "child.matcher.host": "desk"}
    hub = {"child.hub_desk.state": "running", "child.hub_desk.pid": 7, "child.hub_desk.host": "desk"}
    say(bus, "robot/supervisor_desk", **theirs, **hub)
    say(bus, "robot/matcher", 0, "tracking", state="TRACKING")
    lines = lines_of(health)
    line = lines["matcher"]
    assert (line.level, line.restarts, line.state, line.host) == ("ok", 2, "running", "desk")
    assert [(lines[name].pid, lines[name].host) for name in ("hub", "hub_desk")] == [(4, ""), (7, "desk")]
    console = Console(record=True, width=200, file=io.StringIO())
    console.print(table(status_of("robot", health.vitals()), 5.0))
    assert "running on desk" in console.export_text()
    later(monkeypatch, 10.0)
    say(bus, "robot/supervisor", **{"child.hub.state": "running", "child.hub.pid": 4, **expected})
    line = lines_of(health)["matcher"]
    assert (line.level, line.state, line.host) == ("stale", "elsewhere", "desk")


def test_without_a_supervisor_silence_is_a_fault_of_everybody(bus, health, monkeypatch):
    say(bus, "robot/laser", 0, "scanning")
    later(monkeypatch, 10.0)
    assert [line.level for line in status_of("robot", health.vitals()).processes] == ["stale"]


def test_a_process_of_the_run_that_has_ended_stays_in_the_list(bus, health):
    say(bus, "robot/supervisor", **{"child.player.state": "ended"})
    say(bus, "robot/player", 0, "played", leaving=1)
    assert names(health) == ["player", "supervisor"]


def test_whoever_left_gives_way_to_whoever_comes(bus, health):
    for number in range(256):
        say(bus, f"robot/view_{number}", leaving=1)
    say(bus, "robot/laser", 0, "scanning")
    assert list(health.vitals()) == ["laser"]


def lines_of(health):
    return {line.name: line for line in status_of("robot", health.vitals()).processes}


def names(health):
    return [line.name for line in status_of("robot", health.vitals()).processes]


def later(monkeypatch, seconds):
    now = time.monotonic
    monkeypatch.setattr("runtime.process.health.time.monotonic", lambda: now() + seconds)
