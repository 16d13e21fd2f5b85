"""The watchdog process alone: it stops the robot of a driver that hangs or dies, and of no other."""

import contextlib
import os
import signal
import subprocess
import sys
import textwrap
import time
from pathlib import Path

import psutil
import pytest

from drivers.create import protocol, watchdog
from drivers.create.emulator import CreateEmulator
from drivers.create.guard import Guard
from drivers.create.protocol import Mode
from drivers.errors import PortBusyError
from drivers.transport import SerialStream

ROOT = Path(__file__).resolve().parents[2]
MOVE = protocol.start() + protocol.safe() + protocol.drive_direct(200, 200)

DRIVER = """
    import sys, time
    from drivers.create.guard import Guard
    from drivers.transport import SerialStream
    with SerialStream(sys.argv[1], 57600) as line, Guard() as guard:
        guard.lend(line.fileno())
        guard.beat(True)
        line.write(bytes((128, 131, 145, 0, 200, 0, 200)) + (b"\\x91\\x01" if sys.argv[2] == "cut" else b""))
        print(guard.pid, flush=True)
        while True:
            guard.beat(True)
            time.sleep(0.02)
"""


def wait(condition, within_s=20.0, what="it"):
    end = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end, f"waited {within_s} s for {what}"
        time.sleep(0.002)


def alive(pid):
    return psutil.pid_exists(pid) and psutil.Process(pid).status() != psutil.STATUS_ZOMBIE


@pytest.fixture
def robot():
    with CreateEmulator() as robot:
        yield robot


@contextlib.contextmanager
def driving(robot, last_words="whole"):
    """A driver in a process of its own that has the robot moving; it and its watchdog."""
    command = [sys.executable, "-c", textwrap.dedent(DRIVER), robot.port, last_words]
    process = subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, start_new_session=True)
    dog = int(process.stdout.readline())
    wait(lambda: robot.wheels_mmps == (200, 200), what="turning wheels")
    try:
        yield process, dog
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
    wait(lambda: not alive(dog), what="the end of the watchdog")


@pytest.fixture
def driver(robot, request):
    """See `driving`."""
    with driving(robot, getattr(request, "param", "whole")) as both:
        yield both


def test_its_last_words_are_those_of_the_protocol():
    assert watchdog.STOP == protocol.RESYNCHRONISE


def test_it_says_nothing_while_the_driver_beats():
    def undisturbed():
        with CreateEmulator() as robot, driving(robot):
            time.sleep(0.6)
            return robot.wheels_mmps == (200, 200) and robot.mode is Mode.SAFE

    # Where the machine holds the driver up for a quarter of a second, to stop it is right: another go.
    assert any(undisturbed() for _ in range(10))


@pytest.mark.parametrize("driver", ["whole", "cut"], indirect=True)
def test_a_killed_driver_leaves_a_standing_robot_even_in_the_middle_of_a_command(robot, driver):
    process, _ = driver
    process.kill()
    wait(lambda: robot.mode is Mode.PASSIVE, 10.0, "Passive mode")
    assert robot.wheels_mmps == (0, 0)


@pytest.mark.parametrize("driver", ["whole", "cut"], indirect=True)
def test_a_hung_driver_leaves_a_standing_robot(robot, driver):
    process, _ = driver
    process.send_signal(signal.SIGSTOP)
    wait(lambda: robot.mode is Mode.PASSIVE, 10.0, "Passive mode")
    assert robot.wheels_mmps == (0, 0)
    time.sleep(0.3)
    process.send_signal(signal.SIGCONT)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_no_polite_signal_ends_it(robot, driver, number):
    process, dog = driver
    os.kill(dog, number)
    process.kill()
    wait(lambda: robot.mode is Mode.PASSIVE, 10.0, "Passive mode")


def test_a_kill_of_the_drivers_whole_group_does_not_reach_it(robot, driver):
    process, dog = driver
    assert os.getpgid(dog) != os.getpgid(process.pid)
    os.killpg(process.pid, signal.SIGKILL)
    wait(lambda: robot.mode is Mode.PASSIVE, 10.0, "Passive mode")


def test_it_lets_the_line_go_when_it_has_stopped_the_robot(robot, driver):
    process, dog = driver
    with pytest.raises(PortBusyError):
        SerialStream(robot.port, 57600)
    process.kill()
    wait(lambda: not alive(dog), what="the end of the watchdog")
    SerialStream(robot.port, 57600).close()


def test_a_full_line_is_emptied_for_its_last_words(robot):
    with SerialStream(robot.port, 57600) as line, Guard() as guard:
        line.write(MOVE)
        wait(lambda: robot.wheels_mmps == (200, 200), what="turning wheels")
        robot.block_writes()
        guard.lend(line.fileno())
        guard.beat(True)
        time.sleep(0.5)
        robot.take_writes()
        wait(lambda: robot.mode is Mode.PASSIVE, what="Passive mode")


def test_a_driver_that_stands_may_be_silent(robot):
    with SerialStream(robot.port, 57600) as line, Guard() as guard:
        line.write(MOVE)
        guard.lend(line.fileno())
        guard.beat(False)
        wait(lambda: robot.mode is Mode.SAFE, what="Safe mode")
        time.sleep(0.5)
        assert robot.mode is Mode.SAFE
        guard.take_back()


def test_a_driver_that_took_its_line_back_leaves_in_peace(robot):
    guard = Guard()
    with SerialStream(robot.port, 57600) as line:
        line.write(MOVE)
        guard.lend(line.fileno())
        guard.beat(True)
        guard.take_back()
        wait(lambda: robot.mode is Mode.SAFE, what="Safe mode")
        guard.close()
    assert not alive(guard.pid)
    assert robot.mode is Mode.SAFE


def test_an_unplugged_line_does_not_end_it(robot):
    with SerialStream(robot.port, 57600) as line, Guard() as guard:
        guard.lend(line.fileno())
        guard.beat(True)
        robot.hang_up()
        time.sleep(0.5)  # it tries, and fails, to speak
        guard.beat(True)
        wait(lambda: guard.awake and guard._owes_since is None, what="an answer")


def test_a_dead_watchdog_is_noticed_at_once_and_a_hung_one_soon():
    with Guard() as guard:
        guard.beat(False)
        wait(lambda: guard.awake and guard._owes_since is None, what="an answer")
        os.kill(guard.pid, signal.SIGSTOP)
        began = time.monotonic()
        while guard.awake:
            guard.beat(False)
            time.sleep(0.01)
            assert time.monotonic() - began < 5.0
        guard.renew()
        assert guard.awake
        os.kill(guard.pid, signal.SIGKILL)
        wait(lambda: not guard.awake, what="the notice")
        guard.renew()
        guard.beat(False)
        wait(lambda: guard.awake and guard._owes_since is None, what="an answer")


def test_a_driver_that_hangs_for_long_is_killed_so_that_another_can_drive(robot):
    program = DRIVER.replace("Guard() as guard", "Guard(deaf_s=0.6) as guard")
    command = [sys.executable, "-c", textwrap.dedent(program), robot.port, "whole"]
    with subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, text=True) as process:
        process.stdout.readline()
        wait(lambda: robot.wheels_mmps == (200, 200), what="turning wheels")
        time.sleep(0.8)
        assert process.poll() is None  # it beats
        process.send_signal(signal.SIGSTOP)
        assert process.wait(5) == -signal.SIGKILL
    wait(lambda: robot.mode is Mode.PASSIVE, what="Passive mode")

    def free():
        try:
            SerialStream(robot.port, 57600).close()
        except PortBusyError:
            return False
        return True

    wait(free, what="the port")


def test_answers_that_nobody_reads_are_no_sign_of_sleep():
    with Guard() as guard:
        for _ in range(2000):  # more than fit into the link
            guard._send(b"S")
        guard.beat(False)
        wait(lambda: guard.awake and guard._owes_since is None, what="an answer")


@pytest.mark.parametrize("silence_s", [0.0, 0.3])
def test_a_watchdog_that_would_bark_too_late_is_refused(silence_s):
    with pytest.raises(ValueError, match=f"silence_s = {silence_s}"):
        Guard(silence_s)
