"""Which scan the matcher takes next: a burst in order, and the newest alone when it is too slow."""

import numpy as np
import pytest

from runtime import messages
from runtime.bus.memory import MemoryBus
from runtime.clock import ManualClock
from runtime.nodes import matcher
from runtime.nodes.matcher import KEEP_SCANS, Scans
from runtime.port import ListPort
from runtime.process.node import BusPort
from runtime.topics import topic

PERIOD_NS = topic("scan").period_ns


@pytest.fixture
def bus():
    with MemoryBus() as first:
        yield first


@pytest.fixture
def port(bus):
    with BusPort("matcher", bus.join, subscribes=("scan",), clock=ManualClock(5)) as made:
        yield made


@pytest.fixture
def laser(bus):
    with BusPort("laser", bus.join, publishes=("scan",)) as made:
        yield made


def publish(laser, *numbers):
    for number in numbers:
        laser.publish(
            "scan",
            messages.LaserScan(
                messages.header(number, "laser"),
                *(0.0, 1.0, 0.1, 0.0, 0.1, 0.0, 5.0),
                np.zeros(11, np.float32),
                np.zeros(0, np.float32),
            ),
        )


def taken(scans):
    received = scans.next()
    return None if received is None else received.message.header.stamp.nanosec


def test_scans_that_come_in_a_burst_are_all_taken_in_order(port, laser):
    scans = Scans(port)
    publish(laser, 1)
    assert taken(scans) == 1
    publish(laser, 2, 3, 4)
    assert [taken(scans) for _ in range(4)] == [2, 3, 4, None]
    assert "scans_skipped" not in port.counters()


def test_who_takes_longer_than_a_period_again_gets_the_newest_and_the_others_are_counted(port, laser):
    scans = Scans(port)
    publish(laser, 1)
    assert taken(scans) == 1
    publish(laser, 2, 3)
    port.clock.advance(PERIOD_NS + 1)
    assert taken(scans) == 2  # a stall, for all that is known
    publish(laser, 4, 5)
    port.clock.advance(PERIOD_NS + 1)
    assert taken(scans) == 5
    assert port.counters()["scans_skipped"] == 2
    publish(laser, 6, 7)
    assert [taken(scans), taken(scans)] == [6, 7]  # quick again


def test_the_time_without_any_scan_is_not_the_matcher_s(port, laser):
    scans = Scans(port)
    assert taken(scans) is None
    port.clock.advance(10 * PERIOD_NS)
    publish(laser, 1, 2)
    assert [taken(scans), taken(scans)] == [1, 2]


def test_never_more_than_a_few_wait(port, laser):
    scans = Scans(port)
    publish(laser, *range(1, 20))
    assert taken(scans) == 20 - KEEP_SCANS
    assert port.counters()["scan.overwritten"] == 19 - KEEP_SCANS


def test_the_node_takes_its_scans_from_there():
    port = ListPort(stop_after=0)
    held = []
    port.subscribe = lambda name, **options: held.append((name, options)) or ListPort.subscribe(port, name)
    matcher.run(port, matcher.Config())
    assert held == [("scan", {"keep": KEEP_SCANS})]
