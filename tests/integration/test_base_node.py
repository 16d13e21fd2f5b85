"""The base node with its watchdog on an emulated robot: what it says, whom it obeys, how it leaves."""

import importlib.util
import itertools
import logging
import os
import threading
import time
from pathlib import Path

import pytest

from drivers.create.emulator import CreateEmulator
from drivers.create.operators import Intent
from drivers.create.protocol import Mode, Op
from drivers.errors import PortBusyError, PortMissingError
from drivers.transport import SerialStream
from drivers.world import WheeledRobot, room
from runtime import messages
from runtime.bus.memory import MemoryBus
from runtime.nodes import base
from runtime.process.node import BusPort

_spec = importlib.util.spec_from_file_location("create_rig", Path(__file__).with_name("create_rig.py"))
create_rig = importlib.util.module_from_spec(_spec)
_spec.loader.exec_module(create_rig)
Rig, Operator, wait = create_rig.Rig, create_rig.Operator, create_rig.wait


def lone_port(tmp_path):
    return BusPort(
        "base", MemoryBus().join, subscribes=base.SUBSCRIBES, publishes=base.PUBLISHES, run_dir=tmp_path
    )


def test_it_starts_passive_and_leaves_passive(tmp_path):
    with Rig(tmp_path) as rig:
        wait(lambda: rig.heard(mode="1", state="disarmed"), what="telemetry")
        assert rig.emulator.mode is Mode.PASSIVE
        rig.drive()
        rig.stop()
        assert rig.exit_code == 0
        wait(lambda: rig.emulator.mode is Mode.PASSIVE, what="Passive mode")
        last = [c for _, c in rig.emulator.commands()][-4:]
        assert [c.op for c in last] == [Op.DRIVE_DIRECT, Op.DRIVE_DIRECT, Op.PAUSE_STREAM, Op.START]
        assert last[0].data == last[1].data == bytes(4)


def test_arming_is_logged_once_and_is_no_warning(tmp_path, caplog):
    caplog.set_level(logging.INFO)
    with Rig(tmp_path) as rig:
        rig.drive()
        rig.stop()
    lines = [(record.levelname, record.message) for record in caplog.records]
    assert {("INFO", "arming"), ("INFO", "armed")} <= set(lines)
    assert ("WARNING", "arming") not in lines
    assert all(first != second for first, second in itertools.pairwise(lines))


def test_a_create_2_is_spoken_to_at_its_own_rate_and_left_off(tmp_path):
    emulator = CreateEmulator(link=tmp_path / "base", model="create2")
    with Rig(tmp_path, emulator=emulator, model="create2") as rig:
        rig.drive(0.0, 1.0)
        wait(lambda: emulator.wheels_mmps == (118, -118), what="wheels of the narrower robot")
        assert rig.look()["baud"] == "115200"
        rig.stop()
        wait(lambda: emulator.mode is Mode.OFF, what="the end of the interface")


def test_the_command_goes_out_many_times_a_second_whether_or_not_it_changes(tmp_path):
    with Rig(tmp_path) as rig:
        rig.drive()
        wait(lambda: rig.emulator.wheels_mmps == (200, 200), what="full speed")
        since_ns = time.monotonic_ns()
        wait(lambda: time.monotonic_ns() - since_ns > 1e9, 5.0)
        assert len(rig.emulator.drives(since_ns)) >= 20


def test_telemetry_is_published(tmp_path):
    with Rig(tmp_path) as rig:
        message = rig.battery.wait(10.0).message
        assert message.voltage == pytest.approx(15.2)
        assert message.percentage == pytest.approx(2500 / 2700)
        assert message.power_supply_status == 2
        assert rig.bumper.wait(10.0).message.data == 0
        rig.emulator.body.bumps = 0b01
        assert rig.bumper.wait(10.0).message.data == 0b01
        with rig.emulator.lock:
            rig.emulator.body.overcurrents = 0b1000
        rig.emulator.hazard(cliffs=0b0100, wheel_drops=0b100)
        wait(
            lambda: rig.heard(cliffs="4", wheel_drops="4", overcurrents="8", bumps="1", mode="1"),
            what="everything in diagnostics",
        )
        assert {"current_a", "charging_state", "on_charger", "temperature_c"} <= rig.values.keys()


def test_one_operator_at_a_time_and_the_second_is_told_who(tmp_path):
    with Rig(tmp_path) as rig:
        rig.drive(0.2)
        ben = Operator(rig.bus, "ben")
        ben.stick = (-0.15, 0.0)
        wait(lambda: rig.heard(operator="anna", refused="ben"), what="both names")
        assert min(w for _, w in rig.emulator.drives()) >= (0, 0)
        rig.operator.present = False
        wait(lambda: rig.heard(operator="ben", state="disarmed"), what="ben")
        ben.close()


def test_an_emergency_stop_by_anybody_holds(tmp_path):
    with Rig(tmp_path) as rig:
        rig.drive()
        ben = Operator(rig.bus, "ben")
        ben.say(Intent.STOP)
        rig.state("emergency stop")
        assert rig.level == 2
        assert "ben" in rig.text
        wait(lambda: rig.emulator.wheels_mmps == (0, 0), what="standing wheels")
        rig.operator.stick = (0.0, 0.0)
        time.sleep(0.3)
        rig.operator.say(Intent.ARM)
        time.sleep(0.3)
        assert rig.emulator.mode is Mode.PASSIVE
        rig.operator.say(Intent.RESET)
        rig.state("disarmed")
        rig.arm()
        ben.close()


def test_a_robot_that_bumps_into_a_wall_stops_and_can_back_off(tmp_path):
    robot = WheeledRobot(room(furniture=False), (5.0, 2.5, 0.0), now_ns=time.monotonic_ns())
    with Rig(tmp_path, robot) as rig:

        def at_the_wall():
            if not robot.bumps and rig.look().get("state") != "armed":
                rig.drive(0.3)  # at first, and whenever the machine held the driver up
            return robot.bumps

        wait(at_the_wall, 40.0, "the wall")
        wait(lambda: rig.emulator.wheels_mmps == (0, 0), what="standing wheels")
        wait(lambda: rig.heard(bumps="3"), what="the bump told")
        wall = robot.pose[0]
        for _ in range(5):  # each push backs off for a second at most
            rig.arm()
            time.sleep(0.2)  # the hand lets go before it pulls
            rig.operator.stick = (-0.15, 0.0)
            end = time.monotonic() + 1.5
            while time.monotonic() < end and robot.pose[0] > wall - 0.02:
                time.sleep(0.01)
        assert robot.pose[0] < wall - 0.01
        assert min(min(w) for _, w in rig.emulator.drives()) >= -100


def test_a_wish_that_it_does_not_know_is_counted(tmp_path):
    with Rig(tmp_path) as rig:
        rig.state("disarmed")
        for frame in ("", ":arm", "anna:dance"):
            twist = messages.Twist(
                linear=messages.Vector3(x=0.3, y=0.0, z=0.0), angular=messages.Vector3(x=0.0, y=0.0, z=0.0)
            )
            header = messages.header(rig.operator.port.clock.now_ns(), frame)
            rig.operator.port.publish("cmd_vel", messages.TwistStamped(header=header, twist=twist))
        wait(lambda: rig.heard(unknown_inputs="3"), what="three wishes counted")


def test_a_lost_watchdog_disarms_and_is_replaced(tmp_path):
    with Rig(tmp_path) as rig:
        rig.drive()
        dog = int(rig.look()["watchdog"])
        os.kill(dog, 9)
        wait(lambda: rig.look().get("watchdogs_lost") == "1", what="the loss told")
        assert rig.values["state"] != "armed"
        wait(lambda: rig.look()["watchdog"] != str(dog), what="another watchdog")
        rig.drive()


def test_a_supervisor_that_is_gone_ends_it(tmp_path, monkeypatch):
    with Rig(tmp_path) as rig:
        rig.drive()
        monkeypatch.setattr(base.os, "getppid", lambda: 1)
        wait(lambda: rig.exit_code == 1, what="the end of the node")
        wait(lambda: rig.emulator.mode is Mode.PASSIVE, what="Passive mode")


def test_a_port_that_does_not_exist_is_one_clear_error(tmp_path):
    config = base.Config(path="nowhere", patience_s=0.0)
    with lone_port(tmp_path) as port, pytest.raises(PortMissingError, match="nowhere: no such port"):
        base.run(port, config)


def test_a_port_that_somebody_holds_is_one_clear_error(tmp_path):
    with CreateEmulator(link=tmp_path / "base") as emulator, SerialStream(emulator.port, 57600):
        config = base.Config(path="base", patience_s=0.0)
        with lone_port(tmp_path) as port, pytest.raises(PortBusyError, match="end it first"):
            base.run(port, config)


def test_a_robot_that_is_off_is_reported_with_what_to_do_and_found_when_it_is_switched_on(tmp_path):
    with Rig(tmp_path) as rig:
        rig.state("disarmed")
        with rig.emulator.lock:
            rig.emulator.body.powered = False
        wait(lambda: rig.look() and "is it on?" in rig.text, 30.0, "the advice")
        assert "57600 baud; tried 57600, 19200, 115200" in rig.text
        with rig.emulator.lock:
            rig.emulator.body.powered = True
        wait(lambda: rig.heard(state="disarmed", mode="1"), 30.0, "the robot")


def test_it_stops_within_a_second_while_it_looks_for_a_robot_that_is_silent(tmp_path):
    with CreateEmulator(link=tmp_path / "base") as emulator:
        emulator.body.powered = False
        with lone_port(tmp_path) as port:
            ended = []
            thread = threading.Thread(target=lambda: ended.append(base.run(port, base.Config(path="base"))))
            thread.start()
            wait(lambda: len(emulator.received) > 40, what="the first words")
            port.stop()
            began = time.monotonic()
            thread.join(10.0)
            assert ended == [0]
            assert time.monotonic() - began < 2.0


@pytest.mark.parametrize(
    ("values", "text"),
    [
        ({"watchdog_s": 0.3}, "watchdog_s = 0.3"),
        ({"patience_s": -1.0}, "patience_s = -1.0"),
        ({"baud": 12345}, "baud = 12345"),
        ({"packets": (7, 19)}, "packet 19 carries distance"),
        ({"packets": (7, 35)}, "packets lack 9"),
        ({"baud": 19200}, "47 bytes, must be at most 28 at 19200 baud"),
    ],
)
def test_a_wrong_configuration_is_refused_by_name(values, text):
    with pytest.raises(ValueError, match=text):
        base.Config(path="x", **values)
