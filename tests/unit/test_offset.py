"""The offset of two clocks is found to half a round trip, whichever way the delay goes."""

import threading
import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from runtime.bus.memory import MemoryBus
from runtime.bus.offset import Follower, Offset, measure, measured, tell_time
from runtime.clock import ManualClock


@given(
    st.integers(-(10**12), 10**12),
    st.lists(st.tuples(st.integers(0, 10**8), st.integers(0, 10**8)), min_size=20),
)
def test_the_offset_is_right_to_half_the_quickest_round_trip(offset_ns, delays):
    ours = ManualClock(10**15)
    ways = iter(delays)

    def ask():
        there_ns, back_ns = next(ways)
        ours.advance(there_ns)
        answer = (ours.now_ns() + offset_ns).to_bytes(8, "little", signed=True)
        ours.advance(back_ns)
        return [answer]

    found = measure(ask, ours)
    assert found.round_trip_ns == min(sum(pair) for pair in delays[:20])
    assert abs(found.offset_ns - offset_ns) <= found.round_trip_ns / 2 + 1


@pytest.mark.parametrize("answers", [[], [b"short"], [b"8 bytes!", b"8 bytes!"]])
def test_silence_or_another_language_is_no_offset(answers):
    asked = []
    assert measure(lambda: asked.append(1) or answers, ManualClock()) is None
    assert len(asked) == 1


def test_a_robot_tells_its_time_on_the_bus():
    with MemoryBus() as robot, robot.join() as laptop:
        tell_time(robot, "robot", ManualClock(2_000_000))
        found = measured(laptop, "robot", ManualClock(500_000))
        assert found == Offset(1_500_000, 0)
        assert str(found) == "+1.500 ms ± 0.000 ms"
        assert measured(laptop, "another", ManualClock()) is None


@pytest.mark.parametrize("later_s", [0.0, 0.3])
def test_a_clock_elsewhere_is_set_by_the_robot_s_although_that_comes_later(later_s):
    ours = ManualClock(500_000)
    with MemoryBus() as robot, robot.join() as laptop:
        telling = threading.Timer(later_s, tell_time, (robot, "robot", ManualClock(2_000_000)))
        telling.start()
        follower = Follower(laptop, "robot", ours)
        end = time.monotonic() + 10
        while ours.offset_ns != 1_500_000:
            assert time.monotonic() < end, f"offset {ours.offset_ns}"
            time.sleep(0.01)
        follower.close()
        telling.join()
