"""Whatever happens in whatever order: the wheels turn only while everything is right."""

from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.create.operators import Intent
from drivers.create.safety import State
from tests.unit import create_course

telemetry = st.sampled_from(
    [
        {"bumps_and_drops": 0}, {"bumps_and_drops": 0b00001}, {"bumps_and_drops": 0b10000}, {"cliffs": 0},
        {"cliffs": 4}, {"charging_sources": 0}, {"charging_sources": 2}, {"charging_state": 0},
        {"overcurrents": 0}, {"overcurrents": 16}, {"mode": 1}, {"mode": 2}, {"mode": 3}, {"mode": 0},
        {"voltage_mv": 12_000}, {"voltage_mv": 15_000},
    ]
)  # fmt: skip
actions = st.one_of(
    st.tuples(st.just("sense"), telemetry),
    st.tuples(st.just("stick"), st.tuples(st.floats(-1, 1), st.floats(-4, 4))),
    st.tuples(st.just("stick"), st.just((0.0, 0.0))),
    st.tuples(st.just("say"), st.sampled_from(list(Intent))),
    st.tuples(st.just("other"), st.sampled_from(list(Intent))),
    st.tuples(st.just("present"), st.booleans()),
    st.tuples(st.just("talking"), st.booleans()),
    st.tuples(st.just("hang"), st.integers(50, 400)),
    st.tuples(st.just("fail"), st.just(0)),
    st.tuples(st.just("arm"), st.just(0)),
    st.tuples(st.just("run"), st.integers(1, 30)),
)


@settings(max_examples=200, deadline=None)
@given(st.lists(actions, max_size=40))
def test_the_wheels_turn_only_while_everything_is_right(script):
    course = create_course.Course()
    heard_ms = sensed_ms = None

    def step():
        nonlocal heard_ms, sensed_ms
        before = course.state
        decision = course.step()
        heard_ms = course.now_ms if course.present else heard_ms
        sensed_ms = course.now_ms if course.talking else sensed_ms
        if (decision.left_mmps, decision.right_mmps) == (0, 0):
            return
        assert before is course.state is State.ARMED
        assert course.now_ms - heard_ms <= 250
        assert course.now_ms - sensed_ms <= 250
        seen = course.telemetry
        if course.talking:
            assert seen.mode == 2
            assert not any((seen.cliffs, seen.wheel_drops, seen.on_charger, seen.overcurrents))
        if course.talking and seen.bumps:
            assert decision.left_mmps + decision.right_mmps <= 0
        assert max(abs(decision.left_mmps), abs(decision.right_mmps)) <= 500

    for what, value in script:
        course.now_ms += 1
        if what == "sense":
            course.set(**value)
        elif what in ("stick", "present", "talking"):
            setattr(course, what, value)
        elif what == "say":
            course.say(value)
        elif what == "other":
            course.say(value, name="ben")
        elif what == "hang":
            course.now_ms += value
        elif what == "fail":
            course.safety.fail("no line to the robot")
            assert course.state in (State.DISARMED, State.STOPPED)
        elif what == "arm":
            course.stick, course.present, course.talking = (0.0, 0.0), True, True
            course.set(bumps_and_drops=0, cliffs=0, charging_sources=0, charging_state=0, overcurrents=0)
            for _ in range(8):
                step()
            course.now_ms += 1
            course.say(Intent.ARM)
        else:
            for _ in range(value):
                step()
        step()
