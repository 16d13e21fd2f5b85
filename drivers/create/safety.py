"""Whether the wheels may turn.  Pure: inputs, telemetry and the time come in, wheel speeds go out.

The law of the file: the robot stands unless everything is right.  It moves only while it is armed; it is
armed only by an operator whose stick is at zero; whatever goes wrong disarms it, at once and without a ramp.

    DISARMED --arm--> ARMING --mode reads Safe--> ARMED --anything wrong--> DISARMED
        any --emergency stop--> STOPPED --reset, stick at zero--> DISARMED
"""

from collections import deque
from dataclasses import dataclass
from enum import Enum

from drivers.create.limits import SECOND, SafetyConfig, Throttle
from drivers.create.operators import Input, Intent, Operators
from drivers.create.protocol import Mode, wheel_speeds
from drivers.create.stream import Telemetry

NEUTRAL_NS = 100_000_000
"""For so long the stick must have been at zero before the robot can be armed."""
_PASSIVE_AGAIN_NS = 200_000_000
_REMEMBERED_NS = 500_000_000
_MISHEARD_MMPS = 20


class State(Enum):
    """Whether the robot may move."""

    DISARMED = "disarmed"
    ARMING = "arming"
    ARMED = "armed"
    STOPPED = "emergency stop"


@dataclass(frozen=True, slots=True)
class Decision:
    """What to tell the robot now."""

    left_mmps: int = 0
    right_mmps: int = 0
    enter_safe: bool = False
    """Ask for Safe mode first."""
    enter_passive: bool = False
    """Ask for Passive mode afterwards: nobody is going to drive, and the robot may charge."""


class Safety:
    """Decides, step by step; 20 to 100 steps a second."""

    def __init__(self, config: SafetyConfig, wheel_base_m: float) -> None:
        self._config = config
        self._wheel_base_m = wheel_base_m
        self.operators = Operators()
        self.state = State.DISARMED
        self.reason = "not armed yet"
        """Why the robot stands."""
        self.disarmings = 0
        self._throttle = Throttle(config)
        self._telemetry: Telemetry | None = None
        self._telemetry_ns = 0
        self._stepped_ns: int | None = None
        self._input: Input | None = None
        self._made_ns = 0
        self._neutral_since_ns: int | None = None
        self._arming_ns = 0
        self._overcurrent_ns: int | None = None
        self._low_battery_ns: int | None = None
        self._told: deque[tuple[int, int]] = deque()
        self._passive_ns: int | None = 0
        """When Passive was asked for last; None if it is to be asked for at once."""

    # ---- what happens ----

    def hear(self, given: Input) -> None:
        """Take one input of any operator, in the order of arrival."""
        if given.intent is Intent.STOP:  # by anybody, however old
            self._disarm(f"emergency stop by {given.operator}", State.STOPPED)
            return
        made_ns = self.operators.admit(given, _ns(self._config.input_timeout_s))
        if made_ns is None:
            return
        self._input, self._made_ns = given, made_ns
        if not self._throttle.neutral(given.speed_mps, given.turn_rate_radps):
            self._neutral_since_ns = None
        else:
            self._throttle.release()
            if self._neutral_since_ns is None:
                self._neutral_since_ns = given.received_ns
        if given.intent is Intent.RESET and self.state is State.STOPPED:
            if self._neutral_for(given.received_ns):
                self._disarm("emergency stop reset, not armed")
        elif given.intent is Intent.ARM and self.state is State.DISARMED:
            if cause := self._reason_not_to_arm(given.received_ns):
                self.reason = f"arming refused: {cause}"
            else:
                self.state, self.reason, self._arming_ns = State.ARMING, "arming", given.received_ns

    def sense(self, telemetry: Telemetry, now_ns: int) -> None:
        """Take telemetry; hazards of frames that were skipped are in it."""
        self._telemetry, self._telemetry_ns = telemetry, now_ns
        if telemetry.voltage_mv >= self._config.battery_stop_v * 1000:
            self._low_battery_ns = None
        elif self._low_battery_ns is None:
            self._low_battery_ns = now_ns
        if telemetry.overcurrents:
            self._overcurrent_ns = now_ns
        self._throttle.sense(telemetry.bumps)
        if self.state in (State.ARMING, State.ARMED):
            misheard = "the robot misheard a command" if self._too_fast(telemetry, now_ns) else None
            if cause := _hazard(telemetry) or misheard:
                self._disarm(cause)

    def fail(self, reason: str) -> None:
        """Disarm because of something that only the owner knows: a lost line, a lost watchdog."""
        self._telemetry = None
        if self.state is not State.STOPPED:
            self._disarm(reason)

    def step(self, now_ns: int) -> Decision:
        """Decide what the wheels do until the next step."""
        since_ns = 0 if self._stepped_ns is None else now_ns - self._stepped_ns
        self._stepped_ns = now_ns
        self.operators.release(now_ns)
        if self.state in (State.ARMING, State.ARMED):
            held_up = since_ns > _ns(self._config.step_timeout_s)
            if cause := "the driver was held up" if held_up else self._reason_to_stop(now_ns):
                self._disarm(cause)
        if self.state is State.ARMING:
            return self._arm(now_ns)
        if self.state is State.ARMED:
            assert self._input is not None  # an input armed the robot
            wanted = (self._input.speed_mps, self._input.turn_rate_radps)
            speed, turn = self._throttle.next(*wanted, min(since_ns * 1e-9, 0.1), now_ns)
            left, right = wheel_speeds(speed, turn, self._wheel_base_m)
            self._told.append((now_ns, max(abs(left), abs(right))))
            return Decision(left, right)
        return self._rest(now_ns)

    # ---- what others want to know ----

    def mode(self) -> int | None:
        """Return the robot's mode by the newest telemetry, None without any."""
        if self._telemetry is None:
            return None
        return max(0, self._telemetry.mode - self._config.mode_offset)

    def input_age_s(self, now_ns: int) -> float | None:
        """Return how old the newest input is that counted; None before the first."""
        return None if self._input is None else (now_ns - self._made_ns) * 1e-9

    def input_stamp_ns(self) -> int:
        """Return the operator's own stamp of the newest input that counted; 0 before the first."""
        return 0 if self._input is None else self._input.stamp_ns

    def warnings(self) -> list[str]:
        """Return what an operator should know while the robot works."""
        telemetry, found = self._telemetry, []
        if telemetry is None:
            return []
        if telemetry.voltage_mv < self._config.battery_warn_v * 1000:
            found.append(f"battery at {telemetry.voltage_mv / 1000:.1f} V")
        elif telemetry.charge_mah and telemetry.capacity_mah:  # 0 or wrong with alkaline cells
            share = telemetry.charge_mah / telemetry.capacity_mah
            if share < self._config.battery_warn_share:
                found.append(f"battery at {share:.0%}")
        if telemetry.bumps:
            found.append("bumper pressed")
        return found

    # ---- why not ----

    def _fresh(self, now_ns: int) -> bool:
        age_ns = now_ns - self._telemetry_ns
        return self._telemetry is not None and age_ns <= _ns(self._config.telemetry_timeout_s)

    def _too_fast(self, telemetry: Telemetry, now_ns: int) -> bool:
        """Whether the robot says it was told more than it was: a byte was lost on the way to it."""
        while self._told and now_ns - self._told[0][0] > _REMEMBERED_NS:
            self._told.popleft()
        fastest = max((speed for _, speed in self._told), default=0)
        said = max(abs(telemetry.right_mmps or 0), abs(telemetry.left_mmps or 0))
        return self.state is State.ARMED and said > fastest + _MISHEARD_MMPS

    def _neutral_for(self, now_ns: int) -> bool:
        return self._neutral_since_ns is not None and now_ns - self._neutral_since_ns >= NEUTRAL_NS

    def _battery_empty(self, now_ns: int) -> bool:
        began_ns = self._low_battery_ns
        return began_ns is not None and now_ns - began_ns >= _ns(self._config.battery_stop_s)

    def _reason_to_stop(self, now_ns: int) -> str | None:
        if not self._fresh(now_ns):
            return "no telemetry from the robot"
        if now_ns - self._made_ns > _ns(self._config.input_timeout_s):
            return "no input from the operator"
        if self._battery_empty(now_ns):
            return "battery empty"
        if self.state is State.ARMED and self.mode() != Mode.SAFE:
            return f"the robot left Safe mode by itself (mode {self.mode()})"
        return None

    def _reason_not_to_arm(self, now_ns: int) -> str | None:
        if self._telemetry is None or not self._fresh(now_ns):
            return "no telemetry from the robot"
        if cause := _hazard(self._telemetry):
            return cause
        if self._overcurrent_ns is not None and now_ns - self._overcurrent_ns < SECOND:
            return "too much current in a motor"
        if self._battery_empty(now_ns):
            return "battery empty"
        if (mode := self.mode()) not in (Mode.OFF, Mode.PASSIVE):
            # A Passive robot that says it is in Safe mode would seem armed while it is not.
            return f"mode {mode} is reported where Passive (1) is due; one too high needs mode_offset: 1"
        return None if self._neutral_for(now_ns) else "the stick was not at zero"

    # ---- from state to state ----

    def _arm(self, now_ns: int) -> Decision:
        if self.mode() == Mode.SAFE:  # it was Passive when arming began
            self.state, self.reason = State.ARMED, "armed"
            self._throttle.release()
            return Decision()
        if now_ns - self._arming_ns > _ns(self._config.arming_timeout_s):
            self._disarm(f"arming failed: the robot stays in mode {self.mode()}")
            return self._rest(now_ns)
        return Decision(enter_safe=True)

    def _disarm(self, reason: str, state: State = State.DISARMED) -> None:
        """Forget every speed there was, so that nothing of it can come back."""
        if self.state in (State.ARMING, State.ARMED):
            self.disarmings += 1
            self._passive_ns = None
        self.state, self.reason = state, reason
        self._neutral_since_ns = None
        self._throttle.forget()

    def _rest(self, now_ns: int) -> Decision:
        """Stand, and have the robot in Passive mode, by its own word."""
        listening = self.mode() not in (None, Mode.PASSIVE)
        waited = self._passive_ns is not None and now_ns - self._passive_ns > _PASSIVE_AGAIN_NS
        if self._passive_ns is None or (listening and waited):
            self._passive_ns = now_ns
            return Decision(enter_passive=True)
        return Decision()


def _hazard(telemetry: Telemetry) -> str | None:
    if telemetry.wheel_drops:
        return "wheel dropped"
    if telemetry.cliffs:
        return "cliff"
    if telemetry.on_charger:
        return "charger connected"
    return "too much current in a motor" if telemetry.overcurrents else None


def _ns(seconds: float) -> int:
    return round(seconds * SECOND)
