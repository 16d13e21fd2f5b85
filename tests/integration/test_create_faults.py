"""The seventeen failures of a Create, each through a real pseudo-terminal and pyserial to the base node.

After each: zeros on the wire and nothing but zeros until an operator arms again, or no harm at all.
"""

import time

import pytest

from drivers.create import stream
from drivers.create.emulator import CreateEmulator
from drivers.create.operators import Intent
from drivers.create.protocol import Mode
from drivers.create.stream import Rule
from tests.integration import create_rig
from tests.integration.create_rig import Rig, wait

STOP_MS = 1000.0
"""Far over the 0.35 s that tests/bench/create_stop_times.py measures: a busy machine is no failure."""


@pytest.fixture
def rig(tmp_path):
    with Rig(tmp_path) as rig:
        yield rig


def goes_on(rig, seconds=1.0):
    """Whether the robot drives through what is going on, as far as the machine is not the reason to stand."""
    for _ in range(5):
        rig.drive()
        since_ns = time.monotonic_ns()
        wait(lambda since_ns=since_ns: time.monotonic_ns() - since_ns > seconds * 1e9, seconds + 5)
        if rig.look().get("state") == "armed":
            return {w for _, w in rig.emulator.drives(since_ns)} == {(200, 200)} or (
                min(w for _, w in rig.emulator.drives(since_ns)) > (0, 0)
            )
        assert rig.values["reason"] in create_rig.LOADED, rig.values["reason"]
    return False


@pytest.mark.parametrize(
    ("fault", "counter"), [("flip_bytes", "checksum_errors"), ("drop_bytes", "skipped_bytes")]
)
def test_faults_1_and_2_damaged_frames_cost_themselves_and_the_robot_drives_on(rig, fault, counter):
    rig.drive()
    getattr(rig.emulator, fault)(0.05)
    assert goes_on(rig, 1.5)
    wait(lambda: int(rig.look()[counter]) > 0, what=counter)
    wait(lambda: int(rig.look()["frames"]) > 50, what="good frames")


def test_fault_3_a_header_in_the_data_is_data(rig):
    with rig.emulator.lock:
        rig.emulator.disguise()
        rig.emulator.body.voltage_mv = 15_000
    assert goes_on(rig)
    assert rig.look()["checksum_errors"] == "0"


def test_fault_3_a_voltage_that_no_battery_has_is_no_telemetry(rig):
    fault_ns = rig.provoke(rig.emulator.disguise, "no telemetry")
    assert rig.only_zeros_since(fault_ns) < STOP_MS
    wait(lambda: int(rig.look()["implausible_frames"]) > 5, what="frames counted as implausible")


def test_fault_4_a_robot_that_sums_by_the_old_document_is_understood(tmp_path):
    emulator = CreateEmulator(link=tmp_path / "base")
    emulator.use_rule(Rule.WITHOUT_HEADER)
    with Rig(tmp_path, emulator=emulator) as rig:
        assert goes_on(rig)
        assert rig.values["checksum_errors"] == "0"


def test_fault_4_a_robot_does_not_change_its_rule(rig):
    fault_ns = rig.provoke(
        lambda: rig.emulator.use_rule(Rule.WITHOUT_HEADER),
        "no telemetry",
        lambda: rig.emulator.use_rule(Rule.WITH_HEADER),
    )
    rig.only_zeros_since(fault_ns, 0.3)
    rig.arm()  # connected anew, it is another robot that may sum as it likes


def test_fault_5_a_short_pause_of_the_stream_does_no_harm(rig):
    rig.drive()
    for _ in range(5):
        rig.emulator.silence(0.15)
        time.sleep(0.3)
    assert "no telemetry" not in rig.look()["reason"]


def test_fault_5_after_a_long_pause_the_robot_stands_until_it_is_armed_again(rig):
    fault_ns = rig.provoke(
        lambda: rig.emulator.silence(2.0), "no telemetry", lambda: rig.emulator.silence(0.0)
    )
    assert rig.only_zeros_since(fault_ns, 1.0) < STOP_MS
    rig.drive()


def test_fault_6_a_robot_that_falls_silent_is_told_to_stand_and_its_silence_is_reported(rig):
    fault_ns = rig.provoke(rig.emulator.silence, "no telemetry", lambda: rig.emulator.silence(0.0))
    wait(lambda: rig.look() and "no data from the robot" in rig.text, what="the report")
    assert rig.level == 2
    assert rig.only_zeros_since(fault_ns) < STOP_MS


@pytest.mark.parametrize(
    ("hazard", "reason"),
    [
        ({"cliffs": 8}, "cliff"),
        ({"cliffs": 4}, "cliff"),
        ({"cliffs": 2}, "cliff"),
        ({"cliffs": 1}, "cliff"),
        ({"wheel_drops": 4}, "wheel dropped"),
        ({"wheel_drops": 2}, "wheel dropped"),
        ({"wheel_drops": 1}, "wheel dropped"),
        ({"charger": True}, "charger connected"),
    ],
)
def test_fault_7_each_hazard_ends_safe_mode_and_disarms(rig, hazard, reason):
    fault_ns = rig.provoke(lambda: rig.emulator.hazard(**hazard), reason, rig.emulator.hazard)
    assert rig.emulator.mode is Mode.PASSIVE
    assert rig.emulator.wheels_mmps == (0, 0)
    rig.only_zeros_since(fault_ns, 0.3)
    rig.operator.stick = (0.0, 0.0)
    rig.operator.say(Intent.ARM)
    wait(lambda: rig.look()["reason"].startswith("arming refused"), what="the refusal")
    rig.emulator.hazard()
    rig.arm()


def test_fault_8_a_mode_one_too_high_is_never_taken_for_armed(rig):
    rig.state("disarmed")
    rig.emulator.misreport_mode(1)
    rig.operator.stick = (0.0, 0.0)

    def refused():
        rig.operator.say(Intent.ARM)
        return "mode_offset" in rig.look()["reason"]

    wait(refused, what="the advice")
    assert rig.emulator.wheels_mmps == (0, 0)


@pytest.mark.parametrize("offset", [1, 2])
def test_fault_8_a_mode_that_jumps_while_driving_disarms(rig, offset):
    fault_ns = rig.provoke(
        lambda: rig.emulator.misreport_mode(offset), "left Safe mode", lambda: rig.emulator.misreport_mode(0)
    )
    rig.only_zeros_since(fault_ns, 0.3)


def test_fault_8_with_the_offset_configured_the_robot_drives(tmp_path):
    emulator = CreateEmulator(link=tmp_path / "base")
    emulator.misreport_mode(1)
    safety = create_rig.base.SafetyConfig(mode_offset=1)
    with Rig(tmp_path, emulator=emulator, safety=safety) as rig:
        assert goes_on(rig)


def test_fault_9_a_robot_that_resets_in_mid_drive_is_found_again_and_stands(rig):
    fault_ns = rig.provoke(rig.emulator.reset, "no telemetry")
    assert rig.emulator.wheels_mmps == (0, 0)
    wait(lambda: rig.heard(mode="1"), 30.0, "the robot after its reset")
    rig.only_zeros_since(fault_ns, 0.3)
    rig.drive()


def test_fault_10_a_robot_at_another_rate_is_stopped_there_and_brought_back(rig):
    fault_ns = rig.provoke(
        lambda: rig.emulator.change_baud(19200), "no telemetry", lambda: rig.emulator.change_baud(57600)
    )
    wait(lambda: rig.emulator.wheels_mmps == (0, 0), 10.0, "standing wheels")
    wait(lambda: rig.heard(mode="1", baud="57600"), 20.0, "the robot at its own rate")
    assert rig.emulator.body.baud == 57600
    rig.only_zeros_since(fault_ns, 0.3)
    rig.drive()


def test_fault_11_a_robot_that_ignores_safe_mode_is_not_armed(rig):
    rig.emulator.ignore_safe()
    rig.state("disarmed")

    reasons = set()
    asked = [0.0]

    def failed():
        if time.monotonic() - asked[0] > 2.5:  # long enough for the answer to be told
            asked[0] = time.monotonic()
            rig.operator.say(Intent.ARM)
        reasons.add(rig.look()["reason"])
        return "arming failed: the robot stays in mode 1" in reasons

    wait(failed, 20.0, f"the failed arming, heard {reasons}")
    assert "armed" not in reasons
    rig.emulator.ignore_safe(False)
    rig.arm()


def test_fault_12_with_alkaline_cells_only_the_voltage_counts(rig):
    rig.emulator.alkaline()
    rig.battery.drain()
    rig.arm()
    message = rig.battery.wait(5.0).message
    message = rig.battery.wait(5.0).message
    assert message.voltage == pytest.approx(16.5)
    assert message.charge != message.charge  # not a number
    assert message.percentage != message.percentage
    assert rig.level == 0


def test_fault_13_of_a_backlog_the_newest_counts_and_no_hazard_is_lost(rig):
    rig.arm()
    rig.bumper.drain()
    rig.emulator.hold_back()
    rig.emulator.body.bumps = 0b10
    time.sleep(0.25)
    rig.emulator.body.bumps = 0
    with rig.emulator.lock:
        rig.emulator.body.voltage_mv = 14_321
    time.sleep(0.25)
    rig.emulator.let_go()
    wait(lambda: int(rig.look()["superseded_frames"]) > 20, what="frames that were out of date")
    wait(lambda: rig.look()["voltage_v"] == "14.32", what="the newest voltage")
    seen = [received.message.data for received in rig.bumper.drain()]
    assert 0b10 in seen
    assert seen[-1] == 0


def test_fault_13_two_seconds_without_frames_disarm_whatever_comes_then(rig):
    fault_ns = rig.provoke(rig.emulator.hold_back, "no telemetry", rig.emulator.let_go)
    time.sleep(1.5)
    rig.emulator.let_go()
    rig.only_zeros_since(fault_ns, 0.5)
    rig.drive()


def test_fault_14_a_pulled_cable_disarms_and_the_robot_is_found_under_its_new_name(rig):
    rig.provoke(rig.emulator.hang_up, "no line to the robot", rig.emulator.come_back)
    # The robot drives on: nobody can tell it anything.  That is what Safe mode and low speeds are for.
    back_ns = time.monotonic_ns()
    rig.emulator.come_back()
    wait(lambda: rig.emulator.wheels_mmps == (0, 0), 10.0, "standing wheels")
    wait(lambda: rig.heard(mode="1"), 10.0, "telemetry")
    rig.only_zeros_since(back_ns, 0.5)
    rig.drive()


def test_fault_15_a_line_that_takes_no_bytes_disarms_and_stops_the_robot_when_it_does(rig):
    rig.provoke(rig.emulator.block_writes, "no line to the robot", rig.emulator.take_writes)
    free_ns = time.monotonic_ns()
    rig.emulator.take_writes()
    wait(lambda: rig.emulator.wheels_mmps == (0, 0), 10.0, "standing wheels")
    wait(lambda: rig.heard(mode="1"), 20.0, "telemetry")
    rig.only_zeros_since(free_ns, 0.5)
    rig.drive()


@pytest.mark.parametrize(
    "garbage", [b"AT+CGMM\r\n", bytes(range(256)), b"\x13" * 60, b"\x13\x2c" * 40, b"\xff\x00" * 100]
)
def test_fault_16_garbage_before_the_first_frame_is_dropped_and_counted(tmp_path, garbage):
    emulator = CreateEmulator(link=tmp_path / "base")
    emulator.begin_with_garbage(garbage)
    with Rig(tmp_path, emulator=emulator) as rig:
        wait(lambda: rig.heard(mode="1"), 10.0, "telemetry")
        wait(lambda: int(rig.look()["skipped_bytes"]) >= len(garbage), what="the garbage counted")
        rig.arm()


@pytest.mark.parametrize("begun", [b"\x91", b"\x91\x01\xf4", b"\x94\x20\x07", b"\x8c\x00\x10"])
def test_fault_17_a_command_that_was_cut_before_we_came_neither_moves_nor_deafens_the_robot(tmp_path, begun):
    emulator = CreateEmulator(link=tmp_path / "base")
    now_ns = time.monotonic_ns()
    emulator.body.receive(bytes((128, 131, 145, 0, 200, 0, 200)), now_ns)  # left driving by a crash
    emulator.cut_command(begun)
    assert emulator.body.waiting_for_data
    assert emulator.wheels_mmps == (200, 200)
    with Rig(tmp_path, emulator=emulator) as rig:
        wait(lambda: emulator.wheels_mmps == (0, 0), 5.0, "standing wheels")
        wait(lambda: rig.heard(mode="1"), 10.0, "telemetry")
        rig.arm()


@pytest.mark.parametrize("begun", [b"\x91\x01", b"\x91\x01\xf4\x01"])
def test_fault_17_a_command_that_the_robot_misheard_while_driving_stops_it(rig, begun):
    rig.drive()
    fault_ns = time.monotonic_ns()
    rig.emulator.cut_command(begun)
    wait(lambda: rig.look()["state"] != "armed", what="the end of being armed")
    wait(lambda: rig.emulator.wheels_mmps == (0, 0), 2.0, "standing wheels")
    assert rig.emulator.mode is Mode.PASSIVE
    rig.only_zeros_since(fault_ns, 0.3)
    rig.drive()


def test_distance_and_angle_are_never_asked_for(rig):
    rig.drive()
    rig.emulator.hang_up()
    rig.emulator.come_back()
    wait(lambda: rig.heard(mode="1", connections="2"), 15.0, "the robot again")
    asked = [c for _, c in rig.emulator.commands() if c.op in (142, 148, 149)]
    assert len(asked) >= 2
    for command in asked:
        ids = command.data if command.op == 142 else command.data[1:]
        assert {0, 2, 6, 19, 20, 100}.isdisjoint(ids), list(ids)
        assert set(ids) <= set(stream.PACKETS)
