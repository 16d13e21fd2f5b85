"""Stopping: at any moment, within a second, whatever the line does; and starting again after a kill.

A busy machine may need several goes until it shows how fast a stop is.
"""

import os
import random
import signal
import subprocess
import sys
import threading
import time

import pytest

from drivers.transport import SerialStream
from drivers.urg04lx import faults
from drivers.urg04lx.emulator import Emulator
from drivers.urg04lx.events import Connected, UrgScan
from drivers.urg04lx.model import Mode
from drivers.urg04lx.pair import Session, attach
from drivers.urg04lx.reader import UrgReader

STOP_S = 1.0
GOES = 5
STOPPED = (Mode.IDLE, Mode.SCIP1, Mode.TIME)


def stop_time_s(emulator, at_s, prepare=lambda emulator: None):
    """Start a device, let it run for `at_s`, and return how long stopping takes."""
    reader = UrgReader(attach(emulator))
    with reader:
        prepare(emulator)
        threading.Event().wait(at_s)
        began = time.monotonic()
        reader.close()
        took_s = time.monotonic() - began
        assert not reader._thread.is_alive()
    return took_s


def test_at_any_moment_a_stop_takes_less_than_a_second_and_the_laser_is_off():
    assert any(longest_of_twenty_s() < STOP_S for _ in range(GOES))


def longest_of_twenty_s():
    """Run twenty sensors at once, each stopped at another moment of starting and streaming."""
    moments = [0.005 + 0.08 * n for n in range(20)]
    modes = [list(Mode)[n % 5] for n in range(20)]
    emulators = [Emulator(mode=mode, seed=n) for n, mode in enumerate(modes)]
    results = {}

    def one(emulator, moment):
        with emulator:
            took_s = stop_time_s(emulator, moment)
            end = time.monotonic() + 10.0  # the sensor, too, may be late
            while emulator.sensor.mode not in STOPPED and time.monotonic() < end:
                time.sleep(0.01)
            results[moment] = took_s, emulator.sensor.mode

    threads = [threading.Thread(target=one, args=pair) for pair in zip(emulators, moments, strict=True)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 20
    assert all(mode in STOPPED for _, mode in results.values())
    return max(took_s for took_s, _ in results.values())


@pytest.mark.parametrize(
    "prepare",
    [
        Emulator.silence,
        Emulator.unplug,
        lambda emulator: emulator.fault(b"55"),
        lambda emulator: emulator.spoil(faults.skip, 1000),
        lambda emulator: emulator.send(b"x" * 20_000),
    ],
    ids=["silent", "unplugged", "broken", "no scans", "noise"],
)
@pytest.mark.parametrize("at_s", [0.3, 1.4])
def test_a_stop_takes_less_than_a_second_whatever_is_wrong(prepare, at_s):
    def took_s():
        with Emulator(mode=Mode.STREAMING) as emulator:
            return stop_time_s(emulator, at_s, prepare)

    assert any(took_s() < STOP_S for _ in range(GOES))


def test_unplugged_while_streaming_and_told_to_stop_it_stops():
    def took_s():
        with Emulator(mode=Mode.IDLE) as emulator, Session(attach(emulator), emulator) as session:
            assert session.more_scans(2)
            emulator.unplug()
            began = time.monotonic()
            session.reader.close()
            assert not session.reader._thread.is_alive()
            return time.monotonic() - began

    assert any(took_s() < STOP_S for _ in range(GOES))


def test_closing_the_generator_itself_sends_the_stop_and_frees_the_port():
    with Emulator(mode=Mode.IDLE, speed=4.0) as emulator:
        events = attach(emulator, speed=4.0).events()
        for event in events:
            if isinstance(event, UrgScan):
                break
        events.close()
        assert emulator.requests[-1] == b"QT"
        assert emulator.sensor.mode is Mode.IDLE
        SerialStream(emulator.port, 115_200).close()


def test_a_consumer_that_sleeps_for_ten_seconds_gets_the_newest_scans_and_the_losses_are_counted():
    speed = 4.0
    with Emulator(mode=Mode.IDLE, speed=speed) as emulator:
        session = Session(attach(emulator, speed=speed), emulator, keep=10)
        with session:
            assert session.more_scans(2)
            emulator.sleep(10.0)
            passed = session.device.counts["scans"]
            event = session.reader.read(1.0)
            while not isinstance(event, UrgScan):
                event = session.reader.read(1.0)
            sent = [stamp_ms for stamp_ms, _ in emulator.sweeps]
            assert sent.index(event.sensor_ms) >= passed - 1 - 10
            assert session.reader.overwritten > 80
            assert session.device.decoder.damaged.total() == 0
            assert session.device.sequence.missed <= emulator.dropped


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_bug_in_the_reader_is_an_error_of_the_consumer_and_no_silence():
    def broken():
        raise ZeroDivisionError

    with Emulator(mode=Mode.IDLE) as emulator:
        device = attach(emulator)
        device._find = broken
        with UrgReader(device) as reader, pytest.raises(RuntimeError, match="has ended"):
            reader.read(5.0)


def test_signals_at_a_hundred_hertz_interrupt_nothing():
    ticks = []
    before = signal.signal(signal.SIGALRM, lambda *_: ticks.append(1))
    try:
        signal.setitimer(signal.ITIMER_REAL, 0.01, 0.01)
        with Emulator(mode=Mode.IDLE) as emulator:
            device = attach(emulator)
            events = device.events()  # in this thread: the one that gets the signals
            scans = []
            for event in events:
                if isinstance(event, UrgScan):
                    scans.append(event)
                    if len(scans) == 12:
                        break
            events.close()
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert len(ticks) > 20
    assert device.counts["restarts"] == device.counts["failures"] == 0
    assert device.sequence.missed <= emulator.dropped
    assert device.decoder.damaged.total() == 0


# What is started and killed: it forks the driver on demand, so that its imports are paid for once.
DRIVER = """
import os, signal, sys, time
from drivers.urg04lx.device import Urg
from drivers.urg04lx.events import UrgScan
from drivers.urg04lx.settings import UrgConfig

def drive(port):
    scans = 0
    for event in Urg(UrgConfig(port=port), patience_s=5.0).events():
        if isinstance(event, UrgScan):
            scans += 1
            os.write(1, b"scan\\n")

for line in sys.stdin:
    child = os.fork()
    if child == 0:
        drive(line.strip())
        os._exit(0)
    os.write(1, b"%d\\n" % child)
    os.waitpid(child, 0)
    os.write(1, b"dead\\n")
"""


def killed_again_and_again(emulator, kills, rng):
    """Start and kill -9 a driver at random moments; then it must still come to scans."""
    with subprocess.Popen(
        [sys.executable, "-c", DRIVER], stdin=subprocess.PIPE, stdout=subprocess.PIPE, bufsize=0
    ) as launcher:
        assert launcher.stdin is not None
        assert launcher.stdout is not None
        output = launcher.stdout
        with_scans = 0
        for kill in range(kills + 1):
            launcher.stdin.write(emulator.port.encode() + b"\n")
            child = int(output.readline())
            last = kill == kills
            if last or rng.random() < 0.5:  # while it streams: somewhere in a scan
                assert output.readline() == b"scan\n"
                with_scans += 1
            threading.Event().wait(rng.uniform(0.0, 0.15 if not last else 0.0))
            os.kill(child, signal.SIGKILL)
            while (line := output.readline()) != b"dead\n":
                assert line == b"scan\n"
        launcher.stdin.close()
    return with_scans


def test_fifty_kills_at_random_moments_and_the_next_start_always_works():
    failures = []

    def line(seed):
        try:
            with Emulator(seed=seed) as emulator:
                assert killed_again_and_again(emulator, 10, random.Random(seed)) >= 2
                # Left streaming by the last kill, and a driver of this process takes over.
                with Session(attach(emulator), emulator) as session:
                    assert session.more_scans(2, 15.0)
                assert any(isinstance(c, Connected) for c in session.connections)
        except Exception as error:
            failures.append(error)
            raise

    threads = [threading.Thread(target=line, args=(seed,)) for seed in range(5)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
