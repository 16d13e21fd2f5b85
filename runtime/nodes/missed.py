"""How many scans never came before each one: the live matcher and whoever reads a recording count alike."""

from runtime.formats.stamp_holes import HOLE_S


class Missed:
    """Goes by the numbers of the laser; by the stamps where another one goes on, whose numbers begin anew."""

    def __init__(self) -> None:
        self._publisher: object = None
        self._sequence, self._stamp_ns = -1, 0

    def before(self, publisher: object, sequence: int, stamp_ns: int, period_s: float) -> int:
        """Take the next scan; return how many are missing before it, those of five seconds at most.

        Args:
            publisher: Whatever names it.
            sequence: Its number; negative if it has none.
            stamp_ns: Of the scan.
            period_s: From scan to scan, by the sensor's own rate.
        """
        if self._stamp_ns == 0:
            missed = 0
        elif publisher == self._publisher and sequence > self._sequence >= 0:
            missed = sequence - self._sequence - 1
        else:
            missed = round((stamp_ns - self._stamp_ns) / (period_s * 1e9)) - 1
        self._publisher, self._sequence, self._stamp_ns = publisher, sequence, stamp_ns
        return min(max(missed, 0), round(HOLE_S / period_s))
