"""A course for the safety of the base: telemetry, an operator and a clock, step by step, without a robot."""

from dataclasses import replace

from drivers.create.limits import SafetyConfig
from drivers.create.operators import Input, Intent
from drivers.create.safety import Safety, State
from drivers.create.stream import Telemetry

MS = 1_000_000
GOOD = Telemetry(voltage_mv=15_000, temperature_c=25, charge_mah=2500, capacity_mah=2700, mode=1)


class Course:
    """One robot that obeys mode commands at once, one operator, steps of 20 ms."""

    def __init__(self, config=None, *, obedient=True, start_ms=1000):
        self.safety = Safety(config or SafetyConfig(), 0.258)
        self.now_ms = start_ms
        self.telemetry = GOOD
        self.talking = True  # the robot sends telemetry
        self.present = True  # the operator sends inputs
        self.stick = (0.0, 0.0)
        self.obedient = obedient
        self.decisions = []

    @property
    def state(self):
        return self.safety.state

    def set(self, **changes):
        self.telemetry = replace(self.telemetry, **changes)

    def say(self, intent=Intent.DRIVE, name="anna", age_ms=0.0):
        made_ns = round((self.now_ms - age_ms) * MS)
        self.safety.hear(Input(name, made_ns, self.now_ms * MS, *self.stick, intent))

    def step(self, ms=20):
        self.now_ms += ms
        if self.talking:
            self.safety.sense(self.telemetry, self.now_ms * MS)
        if self.present:
            self.say()
        decision = self.safety.step(self.now_ms * MS)
        if self.obedient and decision.enter_safe:
            self.set(mode=2)
        if decision.enter_passive:
            self.set(mode=1)
        self.decisions.append(decision)
        return decision

    def run(self, ms, step_ms=20):
        """Step for a while; return the wheel speeds (left, right) of each step."""
        taken = [self.step(step_ms) for _ in range(0, ms, step_ms)]
        return [(d.left_mmps, d.right_mmps) for d in taken]

    def arm(self):
        self.stick = (0.0, 0.0)
        self.run(200)
        self.now_ms += 1
        self.say(Intent.ARM)
        self.run(100)
        assert self.state is State.ARMED, self.safety.reason
        return self

    def drive(self, speed, turn=0.0, ms=1000):
        self.stick = (speed, turn)
        return self.run(ms)
