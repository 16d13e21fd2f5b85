"""The frame of a node, on the bus in memory: numbers, heartbeat, signals, and what it refuses."""

import threading
import time

import numpy as np
import pytest

from runtime import messages
from runtime.bus.contract import Mailbox
from runtime.bus.memory import MemoryBus
from runtime.clock import ManualClock
from runtime.messages import Attachment
from runtime.process.health import Health
from runtime.process.node import BusPort
from runtime.topics import topic


def key(name, robot="robot"):
    return messages.topic_key(f"{robot}/{name}", topic(name).type)


def battery(volts):
    values = dict.fromkeys(
        ("temperature", "current", "charge", "capacity", "design_capacity", "percentage"), 0.0
    )
    states = dict.fromkeys(("power_supply_status", "power_supply_health", "power_supply_technology"), 0)
    empty = np.zeros(0, np.float32)
    return messages.BatteryState(
        header=messages.header(0, ""),
        voltage=volts,
        **values,
        **states,
        present=True,
        cell_voltage=empty,
        cell_temperature=empty,
        location="",
        serial_number="",
    )


def bump(bits):
    return messages.UInt8(data=bits)


@pytest.fixture
def bus():
    with MemoryBus() as first:
        yield first


@pytest.fixture
def port(bus):
    made = BusPort(
        "base",
        bus.join,
        subscribes=("bumper", "battery"),
        publishes=("bumper", "battery"),
        clock=ManualClock(99),
    )
    yield made
    made.close()


def test_the_bus_is_opened_only_when_it_is_needed():
    opened = []
    with BusPort("x", lambda: opened.append(1) or MemoryBus(), publishes=("bumper",)) as port:
        assert not port.stopping
        port.count("things")
        port.report("ok", "fine")
        assert opened == []
        port.publish("bumper", bump(1))
        port.publish("bumper", bump(2))
        assert opened == [1]


def test_messages_are_numbered_stamped_and_named(bus, port):
    mailbox = Mailbox(8)
    bus.subscribe(key("bumper"), mailbox.put)
    port.publish("bumper", bump(1))
    port.publish("bumper", bump(2))
    first, second = mailbox.take_all()
    assert (first.attachment.sequence, second.attachment.sequence) == (1, 2)
    assert first.attachment.published_ns == 99
    assert first.attachment.gid == second.attachment.gid
    assert messages.decode(bytes(first.payload), "std_msgs/msg/UInt8").data == 1


def test_a_node_hears_what_was_sent_with_who_and_when(bus, port):
    subscription = port.subscribe("bumper")
    gid = bytes(16)
    bus.publisher(key("bumper")).put(messages.encode(bump(5)), Attachment(7, 42, gid).encode())
    received = subscription.wait(1.0)
    assert (received.topic, received.message.data) == ("bumper", 5)
    assert (received.sequence, received.published_ns, received.gid) == (7, 42, gid)
    assert received.payload == messages.encode(bump(5))


def test_a_raw_subscription_decodes_nothing(bus, port):
    subscription = port.subscribe("bumper", raw=True)
    bus.publisher(key("bumper")).put(b"anything", b"")
    received = subscription.wait(1.0)
    assert (received.message, received.payload, received.sequence) == (None, b"anything", -1)


def test_garbage_is_counted_and_skipped(bus, port):
    subscription = port.subscribe("bumper")
    publisher = bus.publisher(key("bumper"))
    publisher.put(b"garbage", b"")
    publisher.put(messages.encode(bump(3)), b"")
    assert subscription.wait(1.0).message.data == 3
    assert subscription.undecodable == 1


def test_the_table_says_how_much_is_kept_and_a_node_may_say_otherwise(bus, port):
    newest, all_of_them = port.subscribe("battery"), port.subscribe("battery", keep=8)
    publisher = bus.publisher(key("battery"))
    for number in range(1, 4):
        publisher.put(messages.encode(battery(float(number))), Attachment(number, 0, bytes(16)).encode())
    assert newest.wait(0.0).message.voltage == 3.0
    assert newest.wait(0.0) is None
    assert newest.overwritten == 2
    assert [received.message.voltage for received in all_of_them.drain()] == [1.0, 2.0, 3.0]
    assert all_of_them.overwritten == 0


def test_topics_that_a_node_did_not_declare_are_refused(port):
    with pytest.raises(ValueError, match="subscribes 'scan', which is not in its SUBSCRIBES"):
        port.subscribe("scan")
    with pytest.raises(ValueError, match="publishes 'scan', which is not in its PUBLISHES"):
        port.publish("scan", bump(1))


def test_stopping_ends_a_wait(port):
    subscription = port.subscribe("bumper")
    stopper = threading.Timer(0.05, port.stop)
    stopper.start()
    began = time.monotonic()
    assert subscription.wait(30.0) is None
    assert time.monotonic() - began < 5.0
    assert port.stopping
    stopper.join()


def test_the_first_message_of_a_type_does_not_wait_for_its_reader_to_be_made(bus, monkeypatch):
    monkeypatch.setattr(messages.TYPES, "cache", {})
    with BusPort("x", bus.join, subscribes=("scan", "map"), publishes=("pose",)) as port:
        port.subscribe("scan")
        port.subscribe("map", raw=True)
        made = {name for name in ("scan", "map", "pose") if topic(name).type in messages.TYPES.cache}
    assert made == {"scan", "pose"}


def test_ready_is_a_token_and_a_word(bus, port):
    health = Health(bus, "robot")
    port.subscribe("bumper")
    assert health.ready() == set()
    port.ready()
    assert health.ready() == {"base"}
    vital = health.vitals()["base"]
    assert (vital.level, vital.text, vital.values["ready"]) == ("ok", "running", "1")
    port.close()
    assert health.ready() == set()


def test_a_change_of_level_is_told_at_once_and_a_change_of_text_with_the_next_beat(bus, port):
    health = Health(bus, "robot")
    port.ready()
    port.report("warn", "slipping", wheels=2)
    vital = health.vitals()["base"]
    assert (vital.level, vital.text, vital.values["wheels"]) == ("warn", "slipping", "2")
    port.report("warn", "slipping much")
    assert health.vitals()["base"].text == "slipping"
    port.beat()
    assert health.vitals()["base"].text == "slipping much"


def test_a_change_of_state_is_told_at_once_and_what_stands_behind_it_with_the_next_beat(bus, port):
    health = Health(bus, "robot")
    port.ready()
    port.report("ok", "arming", state="arming")
    assert health.vitals()["base"].values["state"] == "arming"
    port.report("ok", "armed", state="armed (2 s)")
    port.report("ok", "armed", state="armed (3 s)")
    assert health.vitals()["base"].values["state"] == "armed (2 s)"


def test_everything_counted_is_published(bus, port):
    health = Health(bus, "robot")
    subscription = port.subscribe("bumper")
    publisher = bus.publisher(key("bumper"))
    publisher.put(messages.encode(bump(1)), Attachment(1, 0, bytes(16)).encode())
    publisher.put(messages.encode(bump(1)), Attachment(5, 0, bytes(16)).encode())
    subscription.drain()
    port.count("crashes")
    port.count("crashes", 2)
    port.publish("battery", battery(1.0))
    port.ready()
    values = health.vitals()["base"].values
    assert values["bumper.received"] == "2"
    assert values["bumper.missed"] == "3"
    assert values["battery.published"] == "1"
    assert values["crashes"] == "3"
    assert float(values["rss_mb"]) > 1


def test_a_heartbeat_comes_by_itself(bus, port):
    mailbox = Mailbox(8)
    bus.subscribe(key("diagnostics"), mailbox.put)
    port.ready()
    assert mailbox.take(0.0) is not None
    assert mailbox.take(5.0) is not None


def test_work_longer_than_the_period_is_a_missed_deadline(bus, monkeypatch):
    with BusPort("matcher", bus.join, subscribes=("truth",)) as port:
        subscription = port.subscribe("truth", raw=True)
        publisher = bus.publisher(key("truth"))
        now_ns = [0]
        monkeypatch.setattr("runtime.bus.inbox.time.monotonic_ns", lambda: now_ns[0])
        for work_ms in (50, 150, 99):
            now_ns[0] += 1
            publisher.put(b"x", b"")
            assert subscription.wait(0.0) is not None
            now_ns[0] += work_ms * 1_000_000
            assert subscription.wait(0.0) is None
        assert subscription.deadline_misses == 1
        assert subscription.worst_work_ns == 150_000_000


def test_how_long_messages_waited_to_be_taken_is_told(bus, monkeypatch):
    now_ns = [1]
    monkeypatch.setattr("runtime.bus.inbox.time.monotonic_ns", lambda: now_ns[0])
    with BusPort("matcher", bus.join, subscribes=("bumper", "truth")) as port:
        queued, newest = port.subscribe("bumper", raw=True), port.subscribe("truth", raw=True)
        publishers = bus.publisher(key("bumper")), bus.publisher(key("truth"))
        for _ in range(3):
            for publisher in publishers:
                publisher.put(b"x", b"")
            now_ns[0] += 40_000_000
        assert newest.wait(0.0) is not None
        assert len(queued.drain()) == 3
        values = port.counters()
        assert (values["bumper.queue_ms"], values["truth.queue_ms"]) == ("120.0", "40.0")
        now_ns[0] += 61_000_000_000
        assert port.counters()["bumper.queue_ms"] == "0.0"


def test_a_loop_that_turns_is_told_from_one_that_hangs(port, monkeypatch):
    now_s = [time.monotonic()]
    monkeypatch.setattr("runtime.process.node.time.monotonic", lambda: now_s[0])
    now_s[0] += 30.0
    assert float(port.counters()["loop_age_s"]) > 29
    port.turn()
    assert port.counters()["loop_age_s"] == "0.0"


def test_what_comes_before_a_node_is_ready_is_no_turn_of_its_loop_however_long_it_takes(port, monkeypatch):
    now = time.monotonic
    monkeypatch.setattr("runtime.process.node.time.monotonic", lambda: now() + 50.0)  # compiling took so long
    assert float(port.counters()["loop_age_s"]) > 49
    port.ready()
    assert float(port.counters()["loop_age_s"]) < 10


def test_a_late_node_gets_the_map_that_was_published_before(bus):
    with (
        BusPort("mapper", bus.join, publishes=("map",)) as mapper,
        BusPort("viewer", bus.join, subscribes=("map",)) as viewer,
    ):
        mapper.publish_raw("map", b"\x00\x01\x00\x00abc")
        assert viewer.subscribe("map", raw=True).wait(0.0).payload == b"\x00\x01\x00\x00abc"


def test_two_robots_on_one_bus_do_not_hear_each_other(bus):
    with (
        BusPort("a", bus.join, publishes=("bumper",), robot="left") as left,
        BusPort("b", bus.join, subscribes=("bumper",), robot="right") as right,
    ):
        subscription = right.subscribe("bumper")
        left.publish("bumper", bump(1))
        assert subscription.wait(0.0) is None
