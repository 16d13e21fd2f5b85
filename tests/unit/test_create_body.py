"""The emulated robot obeys as the specification says; time is an argument."""

import pytest

from drivers.create import protocol, stream
from drivers.create.body import BOOT_NS, MILLISECOND, Body
from drivers.create.protocol import Mode
from drivers.create.stream import PACKETS, StreamDecoder
from drivers.world import Building, WheeledRobot


def robot(*commands, **attributes):
    body = Body()
    for name, value in attributes.items():
        setattr(body, name, value)
    for command in commands:
        body.receive(command, 0)
    return body


READY = (protocol.start(), protocol.safe())
SECONDS = 1000 * MILLISECOND


def frames(body, until_ms, from_ms=0):
    decoder = StreamDecoder(PACKETS)
    out = []
    for ms in range(from_ms, until_ms + 1):
        for piece in body.transmit(ms * MILLISECOND):
            out += decoder.feed(piece)
    return out


def test_a_robot_that_is_off_hears_only_start():
    body = robot(protocol.safe(), protocol.drive_direct(100, 100))
    assert (body.mode, body.wheels_mmps) == (Mode.OFF, (0, 0))
    body.receive(protocol.start(), 0)
    assert body.mode is Mode.PASSIVE


def test_in_passive_mode_driving_is_silently_ignored():
    assert robot(protocol.start(), protocol.drive_direct(100, 100)).wheels_mmps == (0, 0)


@pytest.mark.parametrize(
    ("command", "wheels"),
    [
        (protocol.drive_direct(150, -50), (150, -50)),
        (protocol.drive(200, protocol.STRAIGHT), (200, 200)),
        (protocol.drive(200, 0x7FFF), (200, 200)),
        (protocol.drive(100, protocol.SPIN_COUNTER_CLOCKWISE), (100, -100)),
        (protocol.drive(100, protocol.SPIN_CLOCKWISE), (-100, 100)),
        (protocol.drive(-200, 500), (-252, -148)),
        (bytes((145, 0x7F, 0xFF, 0x80, 0x00)), (500, -500)),
    ],
)
def test_in_safe_mode_it_drives(command, wheels):
    assert robot(*READY, command).wheels_mmps == wheels


def test_the_last_command_holds_for_ever():
    body = robot(*READY, protocol.drive_direct(100, 100))
    body.transmit(3600 * SECONDS)
    assert body.wheels_mmps == (100, 100)


@pytest.mark.parametrize(
    ("hazard", "command", "stops"),
    [
        ({"cliffs": 1}, protocol.drive_direct(100, 100), True),
        ({"cliffs": 1}, protocol.drive_direct(-100, -100), False),
        ({"cliffs": 1}, protocol.drive_direct(-200, 50), True),  # backward in a turn tighter than itself
        ({"cliffs": 1}, protocol.drive_direct(100, -100), False),
        ({"wheel_drops": 4}, protocol.drive_direct(-100, -100), True),
        ({"wheel_drops": 1}, protocol.STAND, True),
        ({"charger": True}, protocol.STAND, True),
        ({"bumps": 3}, protocol.drive_direct(100, 100), False),
    ],
)
def test_hazards_end_safe_mode_as_documented(hazard, command, stops):
    body = robot(*READY, command, **hazard)
    body.transmit(MILLISECOND)
    assert body.mode is (Mode.PASSIVE if stops else Mode.SAFE)
    if stops:
        assert body.wheels_mmps == (0, 0)


def test_in_full_mode_nothing_protects_it():
    body = robot(
        protocol.start(),
        protocol.full(),
        protocol.drive_direct(100, 100),
        cliffs=15,
        wheel_drops=7,
        charger=True,
    )
    body.transmit(MILLISECOND)
    assert (body.mode, body.wheels_mmps) == (Mode.FULL, (100, 100))


@pytest.mark.parametrize(
    "command", [protocol.start(), bytes((134,)), bytes((135,)), bytes((136, 255)), bytes((143,))]
)
def test_start_and_demos_lead_to_passive_mode_and_stop_the_wheels(command):
    body = robot(*READY, protocol.drive_direct(100, 100), command)
    assert (body.mode, body.wheels_mmps) == (Mode.PASSIVE, (0, 0))


def test_the_first_frame_comes_at_once_and_then_one_every_15_ms():
    body = robot(protocol.start(), protocol.stream(PACKETS))
    assert len(frames(body, 0)) == 1
    assert len(frames(body, 150, 1)) == 10


def test_the_stream_pauses_and_goes_on_with_its_list():
    body = robot(protocol.start(), protocol.stream(PACKETS), protocol.pause_stream())
    assert frames(body, 100) == []
    body.receive(protocol.resume_stream(), 100 * MILLISECOND)
    assert len(frames(body, 130, 100)) == 3


def test_after_a_pause_of_the_host_frames_come_in_a_burst_that_is_bounded():
    body = robot(protocol.start(), protocol.stream(PACKETS))
    body.transmit(0)
    assert len(body.transmit(60 * MILLISECOND)) == 4
    assert len(body.transmit(100 * SECONDS)) == 10
    assert len(body.transmit(100 * SECONDS + 30 * MILLISECOND)) == 2


def test_a_list_that_does_not_fit_comes_out_cut():
    body = robot(protocol.start(), protocol.stream(PACKETS))
    body.baud = 19200
    assert [len(piece) for piece in body.transmit(0)] == [28]


def test_start_may_end_the_stream():
    body = robot(protocol.start(), protocol.stream(PACKETS), start_ends_stream=True)
    body.receive(protocol.start(), 0)
    assert frames(body, 100) == []


def test_what_the_wheels_were_told_is_read_back():
    body = robot(*READY, protocol.stream(PACKETS), protocol.drive_direct(-30, 170))
    frame = frames(body, 0)[0]
    assert (frame.right_mmps, frame.left_mmps, frame.mode) == (-30, 170, 2)


def test_a_query_is_answered_bare_and_after_a_while():
    body = robot(protocol.start(), protocol.query((35, 22)))
    assert body.transmit(5 * MILLISECOND) == []
    assert body.transmit(20 * MILLISECOND) == [bytes((1,)) + (15_200).to_bytes(2, "big")]


def test_a_reset_robot_is_deaf_for_three_seconds_and_has_forgotten_everything():
    body = robot(*READY, protocol.stream(PACKETS), protocol.baud(19200), protocol.drive_direct(100, 100))
    assert body.baud == 19200
    body.reset(0)
    assert (body.mode, body.wheels_mmps, body.baud) == (Mode.OFF, (0, 0), 57600)
    body.receive(protocol.start(), BOOT_NS - 1)
    assert body.mode is Mode.OFF
    body.receive(protocol.start(), BOOT_NS)
    assert body.mode is Mode.PASSIVE
    assert frames(body, 3100, 3000) == []


def test_a_create_2_knows_how_to_end_the_interface_and_a_create_1_does_not():
    for model, mode in (("create1", Mode.SAFE), ("create2", Mode.OFF)):
        body = Body(model=model)
        for command in (*READY, protocol.stop_interface()):
            body.receive(command, 0)
        assert body.mode is mode


def test_the_charger_charges_only_in_passive_mode():
    body = robot(protocol.start(), protocol.stream(PACKETS), charger=True)
    assert frames(body, 0)[0].charging_state == 2
    body = robot(protocol.start(), protocol.full(), protocol.stream(PACKETS), charger=True)
    assert frames(body, 0)[0].charging_state == 0
    assert frames(body, 15, 15)[0].on_charger


def test_its_wheels_move_a_robot_in_a_world():
    world = WheeledRobot(Building([[99.0, 0.0, 99.0, 1.0]]), (0.0, 0.0, 0.0))
    body = Body(world)
    for command in (*READY, protocol.drive_direct(300, 200)):
        body.receive(command, 0)
    for ms in range(0, 1001, 5):
        body.transmit(ms * MILLISECOND)
    assert world.pose[2] == pytest.approx(0.1 / 0.258, rel=1e-6)
    assert world.pose[0] == pytest.approx(0.25, abs=0.01)
    assert world.pose[1] > 0.04


def test_a_cut_list_filled_with_other_commands_holds_packets_only():
    body = robot(protocol.start(), bytes((148, 12, 7)), protocol.pause_stream(), protocol.RESYNCHRONISE)
    body.transmit(15 * MILLISECOND)
    assert set(body._stream_ids) <= set(stream.SIZES)


def test_an_unknown_model_is_refused():
    with pytest.raises(ValueError, match="model = 'roomba'"):
        Body(model="roomba")
