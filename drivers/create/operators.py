"""Who steers: one operator at a time, and how old an input really is.

An operator is a name.  One holds the robot until it has been silent for two seconds; what others send is
counted and told.

The age of an input is counted from the operator's own stamp, not from the arrival of a message that repeats
it.  Clocks of two machines differ, so the stamps of each operator are compared with the quickest message it
ever got through; where the clocks agree, the stamps are taken at their word.
"""

import math
from collections import OrderedDict
from dataclasses import dataclass
from enum import Enum

AGREEING_CLOCKS_NS = 100_000_000
"""A smaller difference between stamp and arrival is time on the way, a greater one is another clock."""
_DRIFT = 2e-4
"""By how much two clocks may run apart; 0.2 ms in a second."""
_MAX_OPERATORS = 16


class Intent(Enum):
    """What an input asks for besides a motion."""

    DRIVE = ""
    ARM = "arm"
    STOP = "stop"
    """Emergency stop; holds until a RESET."""
    RESET = "reset"


@dataclass(frozen=True, slots=True)
class Input:
    """One input of an operator."""

    operator: str
    stamp_ns: int
    """When the operator made it, by the operator's clock."""
    received_ns: int
    """When it arrived, by ours."""
    speed_mps: float = 0.0
    turn_rate_radps: float = 0.0
    intent: Intent = Intent.DRIVE


@dataclass(slots=True)
class _Known:
    """What is remembered of one operator."""

    stamp_ns: int
    """Of the newest input."""
    heard_ns: int
    least_ns: int
    """Least difference between arrival and stamp so far: difference of the clocks and quickest way."""

    def hear(self, given: Input) -> None:
        grown = self.least_ns + round(_DRIFT * (given.received_ns - self.heard_ns))
        self.least_ns = min(grown, given.received_ns - given.stamp_ns)
        self.stamp_ns, self.heard_ns = given.stamp_ns, given.received_ns

    def offset_ns(self) -> int:
        """Return by how much our clock is ahead of the operator's; 0 where they agree."""
        return 0 if 0 <= self.least_ns < AGREEING_CLOCKS_NS else self.least_ns


class Operators:
    """Lets one operator through."""

    def __init__(self, hold_ns: int = 2_000_000_000) -> None:
        self._hold_ns = hold_ns
        self._known: OrderedDict[str, _Known] = OrderedDict()
        self.holder: str | None = None
        self.refused: str | None = None
        """Who was turned away last, as long as there is a holder."""
        self.repeated_inputs = 0
        """Inputs with a stamp that is not newer than the one before."""
        self.refused_inputs = 0
        self.late_inputs = 0
        """Inputs that were too old when they arrived."""
        self.impossible_inputs = 0
        """Inputs that are no number."""

    def counters(self) -> dict[str, int]:
        """Return what was turned away, by reason."""
        return {
            "repeated_inputs": self.repeated_inputs,
            "refused_inputs": self.refused_inputs,
            "late_inputs": self.late_inputs,
            "impossible_inputs": self.impossible_inputs,
        }

    def admit(self, given: Input, max_age_ns: int) -> int | None:
        """Judge an input.

        Args:
            given: The input, in the order of arrival.
            max_age_ns: From which age on it is not worth anything.

        Returns:
            When it was made, by our clock; None if it does not count.
        """
        self.release(given.received_ns)
        if not (math.isfinite(given.speed_mps) and math.isfinite(given.turn_rate_radps)):
            self.impossible_inputs += 1
            return None
        known = self._remember(given)
        if known is None:
            self.repeated_inputs += 1
            return None
        made_ns = min(given.stamp_ns + known.offset_ns(), given.received_ns)
        if self.holder is None:
            self.holder = given.operator
        if given.operator != self.holder:
            self.refused = given.operator
            self.refused_inputs += 1
            return None
        if given.received_ns - made_ns > max_age_ns:
            self.late_inputs += 1
            return None
        return made_ns

    def release(self, now_ns: int) -> None:
        """Let the holder go that has been silent for too long."""
        if self.holder is not None and now_ns - self._known[self.holder].heard_ns > self._hold_ns:
            self.holder = self.refused = None

    def _remember(self, given: Input) -> _Known | None:
        """Note the input; None if its stamp is not newer than the last one of its operator."""
        known = self._known.get(given.operator)
        # After a long silence an operator may come back with another clock.
        if known is None or given.received_ns - known.heard_ns > self._hold_ns:
            known = _Known(given.stamp_ns, given.received_ns, given.received_ns - given.stamp_ns)
            self._known[given.operator] = known
            for name in list(self._known):
                if len(self._known) > _MAX_OPERATORS and name not in (self.holder, given.operator):
                    del self._known[name]
            return known
        if given.stamp_ns <= known.stamp_ns:
            return None
        known.hear(given)
        return known
