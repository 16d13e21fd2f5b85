"""How fast: limits of speed and acceleration, and what a bump leaves of them.  Pure.

The law of the file: speeding up takes time, slowing down and stopping never do.
"""

from dataclasses import dataclass

SECOND = 1_000_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyConfig:
    """Limits and times; speeds of the robot in m/s and rad/s."""

    max_forward_mps: float = 0.30
    """Fastest way ahead; faster wishes keep their curve, slower."""
    max_backward_mps: float = 0.15
    """Fastest way back: there is no bumper behind."""
    max_turn_rate_radps: float = 1.5
    """Fastest turn."""
    acceleration_mps2: float = 0.5
    """How soon it gets faster; slowing down takes no time."""
    turn_acceleration_radps2: float = 3.0
    """The same of the turn rate."""
    dead_band_mps: float = 0.04
    """Slower motion is none: the wheels do not follow evenly."""
    dead_band_radps: float = 0.05
    """The same of turns."""
    input_timeout_s: float = 0.25
    """Age from which an operator's input is worth nothing."""
    telemetry_timeout_s: float = 0.25
    """Age from which the robot's word is too old to drive by."""
    step_timeout_s: float = 0.2
    """A longer pause between two steps means that nobody was watching."""
    arming_timeout_s: float = 0.3
    """Time in which the robot must take the mode that drives, or arming has failed."""
    backing_off_mps: float = 0.1
    """Fastest way back from a bump."""
    backing_off_s: float = 1.0
    """For how long it may go back while the bumper is pressed."""
    battery_warn_v: float = 13.5
    """Voltage under which it warns."""
    battery_stop_v: float = 12.5
    """Voltage under which it stops, if that lasts."""
    battery_stop_s: float = 5.0
    """So long it must last: motors that start pull the voltage down."""
    battery_warn_share: float = 0.15
    """Share of the charge under which it warns."""
    mode_offset: int = 0
    """By how much this robot's firmware reports its mode too high."""

    def __post_init__(self) -> None:
        limits = {
            "max_forward_mps": (0.04, 0.5), "max_backward_mps": (0.04, 0.5),
            "max_turn_rate_radps": (0.1, 4.25),
            "acceleration_mps2": (0.05, 5.0), "turn_acceleration_radps2": (0.1, 50.0),
            "dead_band_mps": (0.0, 0.1), "dead_band_radps": (0.0, 0.5), "input_timeout_s": (0.05, 0.25),
            "telemetry_timeout_s": (0.05, 0.5), "step_timeout_s": (0.05, 0.25),
            "arming_timeout_s": (0.1, 2.0), "backing_off_mps": (0.01, 0.2), "backing_off_s": (0.1, 5.0),
            "battery_warn_v": (5.0, 25.0), "battery_stop_v": (5.0, 25.0), "battery_stop_s": (0.0, 60.0),
            "battery_warn_share": (0.0, 1.0), "mode_offset": (0, 1),
        }  # fmt: skip
        for name, (low, high) in limits.items():
            if not low <= getattr(self, name) <= high:
                raise ValueError(f"{name} = {getattr(self, name)}, must be in [{low}, {high}]")


class Throttle:
    """Turns what the operator wants into what the robot may do."""

    def __init__(self, config: SafetyConfig) -> None:
        self._config = config
        self._speeds = (0.0, 0.0)
        self._bumped = self._pressed = False
        self._released = True
        self._backing_since_ns: int | None = None

    def neutral(self, speed_mps: float, turn_rate_radps: float) -> bool:
        """Whether a stick in this position means standing still."""
        config = self._config
        return abs(speed_mps) < config.dead_band_mps and abs(turn_rate_radps) < config.dead_band_radps

    def forget(self) -> None:
        """Start from zero the next time."""
        self._speeds = (0.0, 0.0)
        self._bumped, self._released, self._backing_since_ns = self._pressed, False, None

    def sense(self, bumps: int) -> None:
        """Take the bumper bits of the newest telemetry."""
        self._pressed = bool(bumps)
        if self._pressed and not self._bumped:
            self._bumped, self._released, self._backing_since_ns = True, False, None

    def release(self) -> None:
        """Note that the stick is at zero: the next motion is one that the operator chose after a bump."""
        self._released, self._backing_since_ns = True, None
        self._bumped = self._pressed

    def next(self, speed: float, turn: float, dt_s: float, now_ns: int) -> tuple[float, float]:
        """Return the speeds (m/s, rad/s) for the next `dt_s` of what is wanted."""
        config = self._config
        if self.neutral(speed, turn):
            speed = turn = 0.0
        if abs(speed) < config.dead_band_mps:
            speed = 0.0
        # Both by the same factor: the robot stays on the curve that was meant.
        limit = config.max_forward_mps if speed > 0.0 else config.max_backward_mps
        over = max(abs(speed) / limit, abs(turn) / config.max_turn_rate_radps, 1.0)
        speed, turn = self._after_bump(speed / over, turn / over, now_ns)
        speed = _ramped(self._speeds[0], speed, config.acceleration_mps2 * dt_s)
        turn = _ramped(self._speeds[1], turn, config.turn_acceleration_radps2 * dt_s)
        self._speeds = (speed, turn)
        return speed, turn

    def _after_bump(self, speed: float, turn: float, now_ns: int) -> tuple[float, float]:
        """After a bump: stand; pressed anew, back off slowly for a moment, or turn; never go forward."""
        if not self._bumped:
            return speed, turn
        if not self._released or speed > 0.0:
            return 0.0, 0.0
        if speed == 0.0:
            return 0.0, turn
        if self._backing_since_ns is None:
            self._backing_since_ns = now_ns
        if now_ns - self._backing_since_ns > round(self._config.backing_off_s * SECOND):
            return 0.0, 0.0
        factor = min(1.0, self._config.backing_off_mps / -speed)
        return speed * factor, turn * factor


def _ramped(before: float, wanted: float, most: float) -> float:
    """Return the next speed: only a growing one is held back, and a turned one grows from zero."""
    if wanted * before < 0.0:
        before = 0.0
    if abs(wanted) <= abs(before):
        return wanted
    return min(max(wanted, before - most), before + most)
