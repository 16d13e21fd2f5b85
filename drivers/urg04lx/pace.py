"""The clock an emulated sensor lives by: the host's own, or one that runs faster and waits for the sensor.

Law: a clock of its own never shows a time at which something was due that has not been done.  On a busy
machine everything of such a world is late together, and so nothing in it is late.
"""

import time

_SLACK_NS = 5_000_000
"""As late as this a sensor may be; whoever sleeps does not wake to the microsecond."""
_FOREVER_NS = 1 << 62


class Pace:
    """Time, faster than real by a factor; at 1 it is CLOCK_MONOTONIC itself, which waits for nobody.

    Args:
        speed: How many times faster than real.
    """

    def __init__(self, speed: float) -> None:
        self.speed = speed
        real_ns = time.monotonic_ns()
        # One tuple, replaced as a whole: it is read without a lock.
        self._leg = (real_ns, real_ns, _FOREVER_NS)

    def now_ns(self) -> int:
        """Return the time."""
        leg = self._leg
        return self._at_ns(time.monotonic_ns(), leg)

    def done_until(self, due_ns: int) -> None:
        """Let time pass until `due_ns`, and a little more: nothing has to be done before."""
        if self.speed != 1.0:
            real_ns = time.monotonic_ns()
            self._leg = (real_ns, self._at_ns(real_ns, self._leg), due_ns + _SLACK_NS)

    def release(self) -> None:
        """Let time pass for ever: nobody will do anything any more."""
        self.done_until(_FOREVER_NS)

    def sleep(self, duration_s: float) -> None:
        """Sleep until `duration_s` have passed on this clock."""
        until_ns = self.now_ns() + round(duration_s * 1e9)
        while (left_ns := until_ns - self.now_ns()) > 0:
            time.sleep(left_ns / 1e9 / self.speed)

    def _at_ns(self, real_ns: int, leg: tuple[int, int, int]) -> int:
        real_0_ns, true_0_ns, limit_ns = leg
        return min(limit_ns, true_0_ns + round((real_ns - real_0_ns) * self.speed))
