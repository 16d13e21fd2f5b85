"""An emulated Create on a pseudo-terminal, the real base node on it, and an operator; all in one process.

Only the watchdog is a process of its own, as it has to be.
"""

import threading
import time

from drivers.create.emulator import CreateEmulator, stopped_after_ms
from drivers.create.operators import Intent
from runtime.bus.memory import MemoryBus
from runtime.nodes import base
from runtime.nodes.steering import steering_message
from runtime.process.node import BusPort

LOADED = ("the driver was held up", "no input from the operator")
"""Reasons to stand that a busy machine brings about by itself."""


def wait(condition, within_s=10.0, what="it"):
    """Wait until a condition holds; the test fails when it does not in time."""
    end = time.monotonic() + within_s
    while not (value := condition()):
        assert time.monotonic() < end, f"waited {within_s} s for {what}"
        time.sleep(0.005)
    return value


class Operator:
    """A hand on a stick: says twenty times a second where it is."""

    def __init__(self, bus, name="anna"):
        self.name = name
        self.stick = (0.0, 0.0)
        self.port = BusPort(name, bus.join, publishes=("cmd_vel",))
        self.present = True
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._talk, daemon=True)
        self._thread.start()

    def say(self, intent=Intent.DRIVE):
        message = steering_message(self.name, self.port.clock.now_ns(), *self.stick, intent)
        self.port.publish("cmd_vel", message)

    def close(self):
        self._end.set()
        self._thread.join()
        self.port.close()

    def _talk(self):
        while not self._end.wait(0.05):
            if self.present:
                self.say()


class Rig:
    """See above; use as a context."""

    def __init__(self, tmp_path, robot=None, emulator=None, **config):
        self.emulator = emulator or CreateEmulator(robot, link=tmp_path / "base")
        self.bus = MemoryBus()
        self.port = BusPort(
            "base", self.bus.join, subscribes=base.SUBSCRIBES, publishes=base.PUBLISHES, run_dir=tmp_path
        )
        self.config = base.Config(path="base", **config)
        self.exit_code = None
        self.values = {}
        self.text = ""
        self.level = -1
        self._listener = BusPort("listener", self.bus.join, subscribes=("diagnostics", "battery", "bumper"))
        self._diagnostics = self._listener.subscribe("diagnostics")
        self.battery = self._listener.subscribe("battery", keep=64)
        self.bumper = self._listener.subscribe("bumper")
        self.operator = Operator(self.bus)
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self):
        self.exit_code = base.run(self.port, self.config)

    def __enter__(self):
        self.emulator.start()
        self._thread.start()
        return self

    def __exit__(self, *_):
        self.operator.close()
        self.stop()
        self.emulator.close()

    def stop(self):
        self.port.stop()
        self._thread.join(10.0)
        assert not self._thread.is_alive()

    def look(self):
        """Read what the base says of itself; return its values."""
        for received in self._diagnostics.drain():
            for status in received.message.status:
                if status.name == "robot/base":
                    self.values = {entry.key: entry.value for entry in status.values}
                    self.text, self.level = status.message, status.level
        return self.values

    def heard(self, **wanted):
        """Whether the base says these values now."""
        values = self.look()
        return all(values.get(key) == value for key, value in wanted.items())

    def state(self, state, within_s=10.0):
        wait(lambda: self.heard(state=state), within_s, f"state {state}, is {self.values}")

    def arm(self):
        """Hold the stick at zero and ask until the robot is armed, as a person would."""
        self.operator.present = True
        self.operator.stick = (0.0, 0.0)
        asked = 0.0
        end = time.monotonic() + 15.0
        while not self.heard(state="armed"):
            assert time.monotonic() < end, self.values
            if time.monotonic() - asked > 0.15:
                asked = time.monotonic()
                self.operator.say(Intent.ARM)
            time.sleep(0.01)

    def drive(self, speed=0.2, turn=0.0):
        """Arm and push the stick, until the wheels of the robot turn."""
        end = time.monotonic() + 20.0
        while True:
            self.arm()
            self.operator.stick = (speed, turn)
            deadline = time.monotonic() + 2.0
            while time.monotonic() < deadline and max(map(abs, self.emulator.wheels_mmps)) < 100:
                time.sleep(0.005)
            if max(map(abs, self.emulator.wheels_mmps)) >= 100:
                return
            assert time.monotonic() < end, self.values

    def provoke(self, fault, reason, lift=None):
        """Cause a fault while driving; return when (ns) it was.

        A busy machine may stop the robot for a reason of its own just then; the fault is lifted, if it is one
        that lasts, and the course is run again.
        """
        for _ in range(5):
            self.drive()
            fault_ns = time.monotonic_ns()
            fault()
            wait(lambda: self.look().get("state") != "armed", 10.0, "the end of being armed")
            if reason in self.values["reason"]:
                return fault_ns
            assert self.values["reason"] in LOADED, self.values["reason"]
            if lift is not None:
                lift()
        raise AssertionError(f"five times {self.values['reason']!r} instead of {reason!r}")

    def only_zeros_since(self, fault_ns, seconds=0.4):
        """Wait for zeros on the wire, and then that nothing else comes; return ms from fault to zeros."""
        wait(lambda: any(w == (0, 0) for _, w in self.emulator.drives(fault_ns)), what="zeros on the wire")
        time.sleep(0.1)  # what was under way may still come
        quiet_ns = time.monotonic_ns()
        self.operator.stick = (0.3, 0.0)
        wait(lambda: time.monotonic_ns() - quiet_ns > seconds * 1e9, seconds + 5.0)
        assert {w for _, w in self.emulator.drives(quiet_ns)} <= {(0, 0)}
        return stopped_after_ms(self.emulator, fault_ns)
