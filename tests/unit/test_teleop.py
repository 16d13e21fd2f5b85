"""From keys and sticks to wishes, from wishes to messages, and what a person is shown."""

import struct
from types import SimpleNamespace

import pytest

from drivers.create.operators import Intent
from runtime import messages
from runtime.bus.memory import MemoryBus
from runtime.cli.teleop import _Desk
from runtime.clock import ManualClock
from runtime.nodes import gamepad, keyboard, teleop
from runtime.nodes.gamepad import Pad
from runtime.nodes.keyboard import FIRST_HOLD_NS, Keys, Wish
from runtime.nodes.steering import input_of, steering_message
from runtime.port import ListPort, Received

MS = 1_000_000


def pressed(keys, text, at_ms):
    return [(w.speed, w.turn, w.intent) for w in keys.feed(text, at_ms * MS)]


@pytest.mark.parametrize(
    ("text", "speed", "turn"),
    [
        (b"\x1b[A", 0.7, 0.0), (b"w", 0.7, 0.0), (b"W", 0.7, 0.0), (b"\x1bOA", 0.7, 0.0),
        (b"\x1b[B", -0.7, 0.0), (b"s", -0.7, 0.0), (b"\x1b[D", 0.0, 0.7), (b"a", 0.0, 0.7),
        (b"\x1b[C", 0.0, -0.7), (b"d", 0.0, -0.7), (b"q", 0.7, 0.35), (b"e", 0.7, -0.35),
    ],
)  # fmt: skip
def test_a_key_is_a_direction(text, speed, turn):
    assert pressed(Keys(), text, 0) == [(pytest.approx(speed), pytest.approx(turn), Intent.DRIVE)]


@pytest.mark.parametrize(
    ("text", "intent"), [(b" ", Intent.STOP), (b"\n", Intent.ARM), (b"\r", Intent.ARM), (b"r", Intent.RESET)]
)
def test_a_key_is_a_wish(text, intent):
    assert pressed(Keys(), text, 0) == [(0.0, 0.0, intent)]


def test_an_arrow_that_arrives_in_pieces_is_one_arrow():
    keys = Keys()
    assert pressed(keys, b"\x1b", 0) == pressed(keys, b"[", 1) == []
    assert pressed(keys, b"A", 2) == [(pytest.approx(0.7), 0.0, Intent.DRIVE)]


@pytest.mark.parametrize(
    "text", [b"\x1b[5~", b"\x1b[1;5A", b"\x1b[200~", b"\x1bOS", b"\x1bw", b"\x1b[" + b"1" * 14 + b"A"]
)
def test_a_strange_sequence_is_no_motion_and_hides_no_later_key(text):
    keys = Keys()
    assert pressed(keys, text, 0) == []
    assert len(pressed(keys, b"w", 1)) == 1


def test_a_key_pressed_once_counts_for_a_moment():
    keys = Keys()
    keys.feed(b"w", 0)
    assert keys.rest(FIRST_HOLD_NS) is None
    assert keys.rest(FIRST_HOLD_NS + MS) == Wish(FIRST_HOLD_NS + MS)


def test_a_held_key_counts_until_three_repetitions_are_missing():
    keys = Keys()
    keys.feed(b"w", 0)
    for ms in range(500, 800, 33):
        keys.feed(b"w", ms * MS)
    assert keys.rest((797 + 95) * MS) is None
    assert keys.rest((797 + 105) * MS) is not None


def test_no_key_counts_longer_than_the_base_believes_in_an_input():
    keys = Keys()
    for ms in (0, 170, 340):  # a terminal that repeats slowly
        keys.feed(b"w", ms * MS)
    assert keys.rest((340 + 250) * MS) is not None


def test_letting_go_by_pressing_another_key_stops_the_first():
    keys = Keys()
    keys.feed(b"w", 0)
    keys.feed(b"x", 50 * MS)
    assert keys.rest(60 * MS) is not None


def test_the_emergency_stop_ends_a_held_key():
    keys = Keys()
    keys.feed(b"w", 0)
    keys.feed(b" ", 10 * MS)
    assert keys.rest(11 * MS) is not None


def test_plus_and_minus_change_the_speed_within_bounds():
    keys = Keys()
    assert keys.feed(b"+++++++", 0) == []
    assert keys.scale == 1.0
    keys.feed(b"-" * 20, 0)
    assert keys.scale == pytest.approx(0.1)


def test_ctrl_c_wishes_to_leave():
    assert [w.leave for w in Keys().feed(b"\x03", 0)] == [True]


def test_a_key_keeps_the_last_minutes_and_ends_one_that_is_held():
    keys = Keys()
    keys.feed(b"w", 0)
    assert keys.feed(b"k", 1) == [Wish(1, keep=True)]
    assert keys.rest(2) == Wish(2)


def event(kind, number, value):
    return struct.pack("<IhBB", 0, value, kind, number)


BUTTON, AXIS = 1, 2


def test_a_stick_means_nothing_without_the_dead_mans_button():
    pad = Pad()
    pad.feed(event(AXIS, 1, -32767), 0)
    assert pad.motion(5) == Wish(5)
    pad.feed(event(BUTTON, 4, 1), 6)
    assert pad.motion(7) == Wish(7, 1.0, 0.0)
    pad.feed(event(BUTTON, 4, 0), 8)
    assert pad.motion(9) == Wish(9)


def test_a_stick_has_a_dead_zone_and_signs_of_its_own():
    pad = Pad()
    pad.feed(event(BUTTON, 5, 1) + event(AXIS, 1, 3000) + event(AXIS, 0, -32767), 0)
    assert pad.motion(0) == Wish(0, 0.0, 1.0)
    pad.feed(event(AXIS, 0, 32767) + event(AXIS, 1, 18350), 0)
    wish = pad.motion(0)
    assert wish.turn == -1.0
    assert wish.speed == pytest.approx(-0.5, abs=0.01)


def test_buttons_are_wishes_when_they_go_down():
    pad = Pad()
    assert [w.intent for w in pad.feed(event(BUTTON, 0, 1) + event(BUTTON, 1, 1), 0)] == [
        Intent.ARM,
        Intent.STOP,
    ]
    assert pad.feed(event(BUTTON, 0, 0), 0) == []
    assert [w.intent for w in pad.feed(event(BUTTON, 3, 1), 0)] == [Intent.RESET]
    assert pad.feed(event(BUTTON, 2, 1), 5) == [Wish(5, keep=True)]


def test_what_was_held_down_before_is_no_wish():
    assert Pad().feed(event(BUTTON | 0x80, 0, 1), 0) == []


def test_events_may_arrive_in_pieces():
    pad, whole = Pad(), event(BUTTON, 4, 1) + event(AXIS, 1, -32767)
    for i in range(len(whole)):
        pad.feed(whole[i : i + 1], 0)
    assert pad.motion(0).speed == 1.0


def test_a_gamepad_that_is_unplugged_wishes_to_leave(tmp_path):
    device = tmp_path / "js0"
    device.write_bytes(event(BUTTON, 4, 1) + event(AXIS, 1, -32767))
    assert gamepad.attached(tmp_path) == [device]
    pad = gamepad.Gamepad(device, ManualClock(3))
    assert pad.poll(0.0) == [Wish(3, 1.0, 0.0)]
    assert pad.poll(0.0) == [Wish(3, leave=True)]  # end of file, as of a device that is gone
    pad.close()


@pytest.mark.parametrize("intent", list(Intent))
def test_a_message_and_an_input_are_the_same(intent):
    message = steering_message("anna@host/7", 1_234_567_890_123, 0.25, -0.5, intent)
    back = messages.decode(messages.encode(message), message.__msgtype__)
    given = input_of(Received("cmd_vel", back, received_ns=99))
    assert (given.operator, given.stamp_ns, given.received_ns) == ("anna@host/7", 1_234_567_890_123, 99)
    assert (given.speed_mps, given.turn_rate_radps, given.intent) == (0.25, -0.5, intent)


@pytest.mark.parametrize("frame", ["", ":arm", "anna:fly"])
def test_a_message_without_a_name_or_with_an_unknown_wish_is_no_input(frame):
    message = steering_message("anna", 0)
    message.header.frame_id = frame
    assert input_of(Received("cmd_vel", message)) is None


class Hand:
    """A stick that plays wishes, and then leaves."""

    name = "hand"

    def __init__(self, *wishes):
        self.wishes = list(wishes)

    def poll(self, timeout_s):
        return [self.wishes.pop(0)] if self.wishes else [Wish(0, leave=True)]

    def close(self):
        pass


def test_a_wish_goes_out_under_the_time_it_was_made():
    clock = ManualClock(1000 * MS)
    port = ListPort(clock=clock, stop_after=100)
    hand = Hand(Wish(900 * MS, 1.0, -0.5), Wish(950 * MS, intent=Intent.ARM))
    config = teleop.Config(name="anna", speed_mps=0.2, turn_rate_radps=1.0)
    assert teleop.steer(port, config, hand) is teleop.End.LEFT
    sent = [(input_of(Received("cmd_vel", m))) for m in port.said("cmd_vel")]
    assert [(i.stamp_ns // MS, i.speed_mps, i.turn_rate_radps, i.intent) for i in sent[:2]] == [
        (900, 0.2, -0.5, Intent.DRIVE),
        (950, 0.0, 0.0, Intent.ARM),
    ]
    assert sent[-1].speed_mps == 0.0  # the last word is to stand
    assert sent[-1].stamp_ns == 1000 * MS
    assert port.is_ready


def test_the_wish_to_keep_the_last_minutes_moves_nothing():
    port = ListPort(clock=ManualClock(1000 * MS), stop_after=100)
    kept = []
    hand = Hand(Wish(900 * MS, 1.0), Wish(950 * MS, keep=True), Wish(960 * MS, 1.0))
    config = teleop.Config(name="anna", speed_mps=0.2)
    teleop.steer(port, config, hand, keep=lambda: kept.append(len(port.said("cmd_vel"))))
    assert kept == [1]
    sent = [input_of(Received("cmd_vel", message)) for message in port.said("cmd_vel")]
    assert [one.stamp_ns // MS for one in sent[:2]] == [900, 960]


def test_the_person_at_the_desk_is_told_what_was_kept_and_where(capsys):
    with MemoryBus() as bus:
        desk = _Desk(SimpleNamespace(robot="robot"), teleop.Config())
        desk._bus = bus
        told = []
        for _ in range(2):
            desk._keep()
            desk._asking.join()
            told.append(desk._painter.note)
            bus.answer("hallway/robot/keep", lambda asked: b"/results/a/ring-kept-1")
        desk._painter.show(SimpleNamespace(robot_line=lambda: "armed"))
    assert told == [
        "nothing was kept: no recorder of this robot has a ring",
        "the last minutes are kept on the robot: ring-kept-1",
    ]
    assert capsys.readouterr().out == "armed; the last minutes are kept on the robot: ring-kept-1\n"


class Patience(ManualClock):
    """A clock that moves a second each time it is read."""

    def now_ns(self):
        self.advance(1000 * MS)
        return super().now_ns()


def test_a_robot_of_which_nothing_is_heard_is_worth_another_try():
    port = ListPort(clock=Patience(), stop_after=1000)
    hand = Hand(*[Wish(i * MS) for i in range(50)])
    assert teleop.steer(port, teleop.Config(name="anna"), hand) is teleop.End.LOST
    assert len(hand.wishes) > 40


def diagnostics(name, text="", **values):
    entries = [messages.KeyValue(key=k, value=v) for k, v in values.items()]
    status = messages.DiagnosticStatus(level=0, name=name, message=text, hardware_id="", values=entries)
    return messages.DiagnosticArray(header=messages.header(0, ""), status=[status])


def view(now_ms=1000):
    shown = teleop.View("robot", teleop.Config(), "anna", "keyboard")
    shown.now_ns = now_ms * MS
    return shown


def test_the_view_says_that_nobody_is_heard():
    assert view().lines() == [
        "the robot's driver is not heard",
        "keyboard | battery: not heard | match: not heard",
        "link: none",
    ]


def test_the_view_says_who_has_the_robot():
    shown = view()
    shown.hear(diagnostics("robot/base", "armed", operator="ben", input_age_s="0.020"), 900 * MS)
    assert shown.robot_line() == "ben has the robot; armed"
    assert "our input does not count" in shown.link_line()
    shown.hear(
        diagnostics("robot/base", "armed", operator="anna", refused="ben", input_age_s="0.020"), 900 * MS
    )
    assert shown.robot_line() == "armed; ben wants it too"
    assert shown.link_line() == "link: heard 0.1 s ago, our input 20 ms old at the robot"


def test_the_view_says_how_the_match_and_the_battery_are():
    from drivers.create.stream import Telemetry
    from runtime.nodes.battery import battery_message

    shown = view()
    shown.hear(diagnostics("robot/matcher", "", state="DEGENERATE"), 900 * MS)
    shown.hear(diagnostics("robot/mapper", "", state="x"), 900 * MS)
    shown.battery = battery_message(Telemetry(voltage_mv=15_250, charge_mah=1350, capacity_mah=2700), 0)
    assert shown.match_line() == "match: DEGENERATE"
    assert shown.battery_line() == "battery: 15.2 V, 50%"
    shown.battery = battery_message(Telemetry(voltage_mv=16_000), 0)
    assert shown.battery_line() == "battery: 16.0 V"


def test_what_was_heard_long_ago_is_not_heard():
    shown = view(now_ms=9000)
    shown.hear(diagnostics("robot/base", "armed", operator="anna"), 1000 * MS)
    assert shown.robot_line() == "the robot's driver is not heard"


def test_a_gamepad_that_is_not_there_is_one_clear_error(monkeypatch):
    monkeypatch.setattr(gamepad, "attached", list)
    with pytest.raises(teleop.NoStickError, match="no gamepad"):
        teleop.choose_stick("gamepad", ManualClock(), lambda: Hand())
    with pytest.raises(teleop.NoStickError, match="hallway teleop"):
        teleop.run(ListPort(), teleop.Config())
    assert isinstance(teleop.choose_stick("any", ManualClock(), lambda: Hand()), Hand)


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"speed_mps": 0.6}, "speed_mps = 0.6"),
        ({"turn_rate_radps": 0.0}, "turn_rate_radps"),
        ({"name": "a:b"}, "colon"),
    ],
)
def test_a_wrong_configuration_is_refused(values, text):
    with pytest.raises(ValueError, match=text):
        teleop.Config(**values)


def test_two_operators_on_one_machine_have_different_names():
    assert ":" not in teleop.own_name()
    assert teleop.own_name().rpartition("/")[2].isdigit()


def test_the_help_names_every_key():
    for word in ("Enter", "W A S D", "space", "K ", "Ctrl-C"):
        assert word in keyboard.HELP
