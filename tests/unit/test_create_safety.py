"""The robot stands unless everything is right: every rule of the safety of the base, without a robot."""

from itertools import pairwise

import pytest

from drivers.create.limits import SafetyConfig
from drivers.create.operators import Input, Intent
from drivers.create.safety import State
from tests.unit.create_course import MS, Course

ZERO = (0, 0)


def stands(course, ms=2000):
    """Whether nothing but zeros come for a while, with the stick pushed forward."""
    course.stick = (0.3, 0.5)
    return set(course.run(ms)) == {ZERO}


def test_a_robot_that_nobody_armed_stands():
    assert stands(Course())


def test_an_armed_robot_does_what_the_stick_says():
    course = Course().arm()
    assert course.drive(0.2)[-1] == (200, 200)
    assert course.drive(0.2, 0.4)[-1] == (148, 252)
    assert course.drive(0.0, 0.0)[-1] == ZERO


def test_a_stick_that_is_not_at_zero_does_not_arm():
    course = Course()
    course.stick = (0.2, 0.0)
    course.run(500)
    course.now_ms += 1
    course.say(Intent.ARM)
    course.run(200)
    assert course.state is State.DISARMED
    assert course.safety.reason == "arming refused: the stick was not at zero"


def test_a_stick_that_was_pushed_a_moment_ago_does_not_arm():
    course = Course()
    course.drive(0.2)
    course.stick = (0.0, 0.0)
    course.step()
    course.now_ms += 1
    course.say(Intent.ARM)
    assert course.state is State.DISARMED
    course.run(200)
    course.now_ms += 1
    course.say(Intent.ARM)
    assert course.state is State.ARMING


def test_arming_asks_for_safe_mode_and_waits_until_the_robot_says_so():
    course = Course(obedient=False)
    course.run(200)
    course.now_ms += 1
    course.say(Intent.ARM)
    assert course.step().enter_safe
    course.run(100)
    assert course.state is State.ARMING
    course.set(mode=2)
    course.step()
    assert course.state is State.ARMED


def test_a_robot_that_ignores_the_request_is_not_armed():
    course = Course(obedient=False)
    course.run(200)
    course.now_ms += 1
    course.say(Intent.ARM)
    course.run(400)
    assert course.state is State.DISARMED
    assert course.safety.reason == "arming failed: the robot stays in mode 1"
    assert stands(course)


@pytest.mark.parametrize("mode", [2, 3, 4])
def test_a_robot_that_seems_to_obey_before_it_was_asked_is_not_armed(mode):
    course = Course()
    course.run(200)
    course.set(mode=mode)
    course.now_ms += 1
    course.safety.sense(course.telemetry, course.now_ms * MS)
    course.say(Intent.ARM)
    assert course.state is State.DISARMED
    assert f"mode {mode} is reported where Passive (1) is due" in course.safety.reason


def test_a_robot_that_moves_faster_than_it_was_told_is_stopped():
    course = Course().arm()
    course.drive(0.2)
    course.set(right_mmps=215, left_mmps=-215)
    assert course.run(100)[-1] == (200, 200)
    course.set(right_mmps=200, left_mmps=401)
    assert course.run(20) == [ZERO]
    assert course.safety.reason == "the robot misheard a command"


def test_a_speed_of_a_moment_ago_may_still_be_read_back():
    course = Course().arm()
    course.drive(0.3)
    course.set(right_mmps=300, left_mmps=300)
    assert course.drive(0.1, ms=400)[-1] == (100, 100)
    course.drive(0.1, ms=200)
    assert course.state is State.DISARMED


def test_the_speed_of_before_does_not_come_back_with_arming():
    course = Course().arm()
    course.drive(0.3)
    course.set(cliffs=1)
    course.run(20)
    course.set(cliffs=0)
    course.arm()
    assert max(course.drive(0.3, ms=20)[0]) <= 11


def test_after_a_disarming_the_stick_has_to_be_at_zero_for_a_while():
    course = Course().arm()
    course.run(500)  # it stands, the stick at zero all the time
    course.set(cliffs=1)
    course.run(20)
    course.set(cliffs=0)
    course.step()
    course.now_ms += 1
    course.say(Intent.ARM)
    assert course.safety.reason == "arming refused: the stick was not at zero"


@pytest.mark.parametrize("mode", [0, 1, 3, 4])
def test_only_safe_mode_counts_as_armed(mode):
    course = Course().arm()
    course.drive(0.2)
    course.obedient = False
    course.set(mode=mode)
    assert stands(course)
    assert f"left Safe mode by itself (mode {mode})" in course.safety.reason


def test_a_mode_that_reads_one_too_high_is_known_by_configuration():
    course = Course(SafetyConfig(mode_offset=1))
    course.set(mode=2)  # Passive, as this firmware says
    course.run(200)
    course.now_ms += 1
    course.say(Intent.ARM)
    course.obedient = False
    course.run(100)
    assert course.state is State.ARMING
    course.set(mode=3)
    course.step()
    assert course.state is State.ARMED


HAZARDS = {
    "wheel dropped": {"bumps_and_drops": 0b01000},
    "cliff": {"cliffs": 0b0001},
    "charger connected": {"charging_sources": 1},
    "too much current in a motor": {"overcurrents": 0b01000},
}


@pytest.mark.parametrize("reason", HAZARDS)
def test_a_hazard_stops_at_once_and_for_good(reason):
    course = Course().arm()
    course.drive(0.3)
    course.set(**HAZARDS[reason])
    assert course.run(20) == [ZERO]
    assert course.safety.reason == reason
    course.set(bumps_and_drops=0, cliffs=0, charging_sources=0, overcurrents=0)
    assert stands(course, 5000)
    course.arm()
    assert course.drive(0.2)[-1] == (200, 200)


@pytest.mark.parametrize("reason", HAZARDS)
def test_a_hazard_that_is_there_prevents_arming(reason):
    course = Course()
    course.set(**HAZARDS[reason])
    course.run(300)
    course.now_ms += 1
    course.say(Intent.ARM)
    assert course.state is State.DISARMED
    assert course.safety.reason == f"arming refused: {reason}"


def test_after_too_much_current_arming_has_to_wait_a_second():
    course = Course()
    course.set(overcurrents=1)
    course.step()
    course.set(overcurrents=0)
    course.run(500)
    course.now_ms += 1
    course.say(Intent.ARM)
    assert course.state is State.DISARMED
    course.run(1000)
    course.arm()


def test_a_charging_battery_counts_as_a_charger_whatever_the_source_says():
    course = Course()
    course.set(charging_state=2)
    course.run(300)
    course.now_ms += 1
    course.say(Intent.ARM)
    assert course.safety.reason == "arming refused: charger connected"


def test_an_operator_who_is_gone_stops_the_robot_within_a_quarter_second():
    course = Course().arm()
    course.drive(0.3)
    course.present = False
    speeds = course.run(400)
    stopped = speeds.index(ZERO)
    assert stopped * 20 <= 260
    assert set(speeds[stopped:]) == {ZERO}
    assert course.safety.reason == "no input from the operator"


def test_the_age_of_the_input_counts_and_not_that_of_the_message():
    course = Course().arm()
    course.drive(0.3)
    course.present = False
    frozen_ns = course.now_ms * MS
    speeds = []
    for _ in range(30):  # a link layer that repeats the last message for ever
        course.now_ms += 10
        course.safety.hear(Input("anna", frozen_ns, course.now_ms * MS, 0.3, 0.0))
        course.now_ms -= 10
        decision = course.step()
        speeds.append((decision.left_mmps, decision.right_mmps))
    assert speeds.index(ZERO) * 20 <= 260
    assert course.safety.operators.repeated_inputs == 30


def test_an_operator_who_comes_back_has_to_arm_again():
    course = Course().arm()
    course.drive(0.3)
    course.present = False
    course.run(400)
    course.present = True
    assert stands(course)
    course.arm()
    assert course.drive(0.2)[-1] == (200, 200)


def test_short_gaps_in_the_inputs_do_not_stop_the_robot():
    course = Course().arm()
    course.drive(0.3)
    course.present = False
    assert course.run(200)[-1] == (300, 300)
    course.present = True
    assert course.run(100)[-1] == (300, 300)


def test_a_silent_robot_is_told_to_stand_within_a_quarter_second():
    course = Course().arm()
    course.drive(0.3)
    course.talking = False
    speeds = course.run(400)
    assert speeds.index(ZERO) * 20 <= 260
    assert course.safety.reason == "no telemetry from the robot"
    course.talking = True
    assert stands(course)


def test_a_pause_of_the_stream_of_a_fifth_of_a_second_is_survived():
    course = Course().arm()
    course.drive(0.3)
    course.talking = False
    course.run(200)
    course.talking = True
    assert course.run(100)[-1] == (300, 300)


def test_a_driver_that_was_held_up_does_not_go_on():
    course = Course().arm()
    course.drive(0.3)
    course.now_ms += 190
    course.say()
    assert course.run(20) == [ZERO]
    assert course.safety.reason == "the driver was held up"


def test_an_emergency_stop_holds_until_it_is_reset_with_the_stick_at_zero():
    course = Course().arm()
    course.drive(0.3)
    course.say(Intent.STOP, name="ben")
    assert course.run(20) == [ZERO]
    assert course.state is State.STOPPED
    assert "ben" in course.safety.reason
    course.now_ms += 1
    course.say(Intent.ARM)
    course.now_ms += 1
    course.say(Intent.RESET)  # the stick is still pushed
    assert course.state is State.STOPPED
    course.stick = (0.0, 0.0)
    course.run(300)
    course.now_ms += 1
    course.say(Intent.ARM)
    assert course.state is State.STOPPED
    course.now_ms += 1
    course.say(Intent.RESET)
    assert course.state is State.DISARMED
    assert stands(course)
    course.arm()


def test_an_emergency_stop_outlives_a_lost_line():
    course = Course()
    course.say(Intent.STOP)
    course.safety.fail("no line to the robot")
    assert course.state is State.STOPPED


def test_a_late_emergency_stop_still_stops():
    course = Course().arm()
    course.drive(0.3)
    course.say(Intent.STOP, age_ms=5000)
    assert course.run(20) == [ZERO]


def test_only_the_operator_who_has_the_robot_can_reset_its_emergency_stop():
    course = Course().arm()
    course.say(Intent.STOP)
    course.run(300)
    course.now_ms += 1
    course.say(Intent.RESET, name="ben")
    assert course.state is State.STOPPED


def test_a_lost_line_disarms():
    course = Course().arm()
    course.drive(0.3)
    course.safety.fail("no line to the robot")
    assert stands(course)


def test_speeding_up_takes_its_time_and_stopping_does_not():
    course = Course().arm()
    speeds = course.drive(0.3, ms=800)
    gains = [b[0] - a[0] for a, b in pairwise(speeds)]
    assert max(gains) <= 11
    assert speeds[25][0] == pytest.approx(260, abs=15)
    assert speeds[-1] == (300, 300)
    assert course.drive(0.1, ms=20) == [(100, 100)]
    assert course.drive(0.0, ms=20) == [ZERO]


def test_turning_the_other_way_begins_at_zero():
    course = Course().arm()
    course.drive(0.0, 1.5)
    left, right = course.drive(0.0, -1.5, ms=20)[0]
    assert 0 <= left <= 10
    assert -10 <= right <= 0


@pytest.mark.parametrize(
    ("stick", "wheels"),
    [
        ((2.0, 0.0), (300, 300)),
        ((-2.0, 0.0), (-150, -150)),
        ((0.0, 9.0), (-194, 194)),
        ((0.6, 1.0), (236, 364)),
    ],
)
def test_speeds_are_limited_on_the_curve_that_was_meant(stick, wheels):
    assert Course().arm().drive(*stick, ms=2000)[-1] == wheels


@pytest.mark.parametrize("stick", [(0.03, 0.0), (0.0, 0.04), (-0.039, 0.049)])
def test_a_stick_near_zero_is_at_zero(stick):
    assert set(Course().arm().drive(*stick)) == {ZERO}


def test_slow_creeping_is_left_out_of_a_turn():
    assert Course().arm().drive(0.03, 1.0, ms=1000)[-1] == (-129, 129)


def test_a_stick_that_is_no_number_stops_the_robot():
    course = Course().arm()
    course.drive(0.3)
    course.stick = (float("nan"), 0.0)
    speeds = course.run(400)
    assert speeds.index(ZERO) * 20 <= 260
    assert set(speeds[speeds.index(ZERO) :]) == {ZERO}


def test_a_bump_stops_forward_motion_and_leaves_the_robot_armed():
    course = Course().arm()
    course.drive(0.3)
    course.set(bumps_and_drops=0b01)
    assert set(course.run(1000)) == {ZERO}
    assert course.state is State.ARMED
    course.set(bumps_and_drops=0)
    assert set(course.run(1000)) == {ZERO}  # the stick was never at zero


def test_after_a_bump_one_can_back_off_slowly_for_a_second_at_a_time():
    course = Course().arm()
    course.drive(0.3)
    course.set(bumps_and_drops=0b11)
    course.run(100)
    assert set(course.drive(-0.15, ms=500)) == {ZERO}  # not pressed anew
    course.drive(0.0, ms=100)
    assert set(course.drive(0.2, ms=200)) == {ZERO}
    speeds = course.drive(-0.15, ms=1600)
    assert min(speeds) == (-100, -100)
    assert speeds[-1] == ZERO
    assert 900 <= 20 * sum(s != ZERO for s in speeds) <= 1060
    course.drive(0.0, ms=100)
    assert (-100, -100) in course.drive(-0.15, ms=600)


def test_after_a_bump_one_can_turn_away_and_then_drive_on():
    course = Course().arm()
    course.drive(0.3)
    course.set(bumps_and_drops=0b10)
    course.run(100)
    course.drive(0.0, ms=100)
    assert course.drive(0.0, -1.0, ms=600)[-1] == (129, -129)
    course.set(bumps_and_drops=0)
    course.drive(0.0, ms=100)
    assert course.drive(0.2)[-1] == (200, 200)


def test_a_low_battery_warns_and_an_empty_one_stops_after_five_seconds():
    course = Course().arm()
    course.set(voltage_mv=13_400)
    course.run(100)
    assert course.safety.warnings() == ["battery at 13.4 V"]
    course.set(voltage_mv=12_400)
    assert course.drive(0.2, ms=4000)[-1] == (200, 200)
    course.set(voltage_mv=12_600)  # sagging for a moment under load is not empty
    course.run(100)
    course.set(voltage_mv=12_400)
    assert course.run(4000)[-1] == (200, 200)
    assert course.run(1100)[-1] == ZERO
    assert course.safety.reason == "battery empty"
    course.stick = (0.0, 0.0)
    course.run(300)
    course.now_ms += 1
    course.say(Intent.ARM)
    assert course.safety.reason == "arming refused: battery empty"


def test_a_small_charge_warns_but_alkaline_cells_do_not():
    course = Course()
    course.set(charge_mah=300, capacity_mah=2700)
    course.run(40)
    assert course.safety.warnings() == ["battery at 11%"]
    course.set(charge_mah=0, capacity_mah=0)
    course.run(40)
    assert course.safety.warnings() == []


def test_a_disarmed_robot_is_sent_to_passive_until_it_says_so():
    course = Course().arm()
    course.obedient = False
    course.present = False
    course.decisions.clear()
    for _ in range(50):
        course.step()
        course.set(mode=2)  # it does not hear
    asked = [i for i, d in enumerate(course.decisions) if d.enter_passive]
    assert len(asked) >= 3
    course.set(mode=1)
    course.decisions.clear()
    course.run(1000)
    assert not any(d.enter_passive for d in course.decisions)


@pytest.mark.parametrize(
    ("name", "value"),
    [("max_forward_mps", 0.6), ("input_timeout_s", 0.3), ("mode_offset", 2), ("acceleration_mps2", 0.0)],
)
def test_a_limit_out_of_range_is_refused_by_name(name, value):
    with pytest.raises(ValueError, match=f"{name} = {value}, must be in"):
        SafetyConfig(**{name: value})
