"""Sensor time to host time: when was a scan really taken?

The sensor stamps a scan with its own counter, and its first byte arrives a constant latency later, plus
whatever delays there are.  Delays are never negative, so the lower envelope of (arrival - stamp) over the
last seconds, a line because the clocks drift apart, is the offset between the clocks plus the latency.

Law: a stamp is never guessed.  A scan that fits the line badly is held back until the next ones tell whether
it was late (the line holds), its stamp is wrong (it is dropped), or a clock has jumped (a new line begins).
"""

import math
from collections import deque
from dataclasses import dataclass
from itertools import pairwise

from drivers.urg04lx.protocol import STAMP_MODULUS_MS

_QUANTUM_MS = 0.5
"""The counter shows whole milliseconds: on average half a one has passed."""
_AGREE_MS = 20.0
"""Delays that differ by less are the same delay."""
_HELD = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class ClockConfig:
    """What is assumed of the clocks and the way between them."""

    window_s: float = 10.0
    """How far the envelope looks back."""
    latency_ms: float = 99.0
    """From step 0 to the first byte at the host, at least."""
    jitter_ms: float = 2.0
    """How much later than that scans usually come, at most."""
    drift_limit: float = 0.0025
    """By how much the two clocks can differ in rate."""
    jump_ms: float = 50.0
    """A scan that is off by more is held back."""

    def __post_init__(self) -> None:
        if not 1.0 <= self.window_s <= 60.0:
            raise ValueError(f"window_s = {self.window_s}, must be in [1, 60]")
        if not 0.0 <= self.latency_ms <= 1000.0:
            raise ValueError(f"latency_ms = {self.latency_ms}, must be in [0, 1000]")
        if not 0.0 <= self.jitter_ms <= 20.0:
            raise ValueError(f"jitter_ms = {self.jitter_ms}, must be in [0, 20]")
        if not 0.0 <= self.drift_limit <= 0.01:
            raise ValueError(f"drift_limit = {self.drift_limit}, must be in [0, 0.01]")
        if not 5.0 <= self.jump_ms <= 1000.0:
            raise ValueError(f"jump_ms = {self.jump_ms}, must be in [5, 1000]")


@dataclass(frozen=True, slots=True)
class _Arrival:
    """A scan as it came: sensor time unwrapped and host time, both ms since the first scan."""

    sensor_ms: float
    host_ms: float

    @property
    def delay_ms(self) -> float:
        return self.host_ms - self.sensor_ms


class ClockMap:
    """Maps the 24-bit millisecond counter of one sensor to the host's steady clock."""

    def __init__(self, config: ClockConfig | None = None) -> None:
        self._config = config or ClockConfig()
        self._window: deque[_Arrival] = deque()
        self._held: list[_Arrival] = []
        self._origin_ns = 0
        self._raw_ms: int | None = None
        self._sensor_ms = 0
        self._slope = 0.0
        self._intercept_ms = 0.0
        self.jumps = 0
        """How often one of the clocks jumped."""
        self.outliers = 0
        """Scans whose stamp fitted neither what came before nor what came after."""

    def restart(self) -> None:
        """Forget the offset, as after resetting or reopening the sensor; what is held back is dropped."""
        self.outliers += len(self._held)
        self._held.clear()
        self._window.clear()
        self._raw_ms = None

    @property
    def drift(self) -> float:
        """Rate of the host's clock against the sensor's, minus one."""
        return self._slope

    def observe(self, stamp_ms: int, arrival_ns: int) -> list[int | None]:
        """Take the stamp of the next scan and when its first byte came.

        Returns:
            Host times of step 0 (ns) for the scans that are decided now, oldest first and without gaps:
            usually this one, none while it is held back, several when a doubt ends, None for a wrong stamp.
        """
        arrival = self._unwrap(stamp_ms, arrival_ns)
        if not self._window:
            return self._begin([arrival])
        late_ms = arrival.delay_ms - self._offset_ms(arrival.sensor_ms)
        if abs(late_ms) <= self._config.jump_ms:
            decided = [self._late_or_wrong(held) for held in self._held]
            self._held.clear()
            self._extend(arrival)
            return [*decided, self._host_ns(arrival.sensor_ms)]
        self._held.append(arrival)
        return self._judge()

    def _judge(self) -> list[int | None]:
        """Decide about the scans held back, if that is possible yet."""
        held = self._held
        if len(held) < 2:
            return []
        step_ms = held[-1].delay_ms - held[-2].delay_ms
        regular = _regular(held[-1].sensor_ms - held[-2].sensor_ms)
        late = held[-1].delay_ms > self._offset_ms(held[-1].sensor_ms)
        if regular and late and step_ms < -_AGREE_MS:
            # A backlog being worked off: the sensor measured on time, the host read late.
            decided = [self._host_ns(arrival.sensor_ms) for arrival in held]
            held.clear()
            return list(decided)
        agreed = regular and abs(step_ms) <= _AGREE_MS
        if (agreed and not late) or len(held) >= _HELD:
            # Too early is impossible, and too late by the same amount for a while is a new offset.
            newest = held[-1].delay_ms
            fresh = [arrival for arrival in held if abs(arrival.delay_ms - newest) <= _AGREE_MS]
            wrong: list[int | None] = [None] * (len(held) - len(fresh))
            self.outliers += len(wrong)
            self.jumps += 1
            held.clear()
            return wrong + self._begin(fresh)
        return []

    def _late_or_wrong(self, held: _Arrival) -> int | None:
        """Decide about one held scan after the next one fitted the line again."""
        if held.delay_ms > self._offset_ms(held.sensor_ms) and _regular(
            held.sensor_ms - self._window[-1].sensor_ms
        ):
            return self._host_ns(held.sensor_ms)
        self.outliers += 1
        return None

    def _begin(self, arrivals: list[_Arrival]) -> list[int | None]:
        """Start a new line on these scans; the drift is a property of the clocks and survives."""
        self._window.clear()
        for arrival in arrivals:
            self._extend(arrival)
        return [self._host_ns(arrival.sensor_ms) for arrival in arrivals]

    def _unwrap(self, stamp_ms: int, arrival_ns: int) -> _Arrival:
        if self._raw_ms is None:
            if not self._window:
                self._origin_ns = arrival_ns
            self._sensor_ms = 0
        else:
            half = STAMP_MODULUS_MS // 2
            self._sensor_ms += (stamp_ms - self._raw_ms + half) % STAMP_MODULUS_MS - half
        self._raw_ms = stamp_ms
        return _Arrival(float(self._sensor_ms), (arrival_ns - self._origin_ns) / 1e6)

    def _extend(self, arrival: _Arrival) -> None:
        self._window.append(arrival)
        while arrival.sensor_ms - self._window[0].sensor_ms > self._config.window_s * 1e3:
            self._window.popleft()
        self._fit()

    def _fit(self) -> None:
        """Lay the line under the window: the edge of its lower convex hull below the middle.

        Of all lines below all points that one has the least sum of distances to them.
        """
        window, limit = self._window, self._config.drift_limit
        middle = sum(arrival.sensor_ms for arrival in window) / len(window)
        hull: list[tuple[float, float]] = []
        for arrival in window:
            x, y = arrival.sensor_ms, arrival.delay_ms
            while len(hull) >= 2 and _turns_right(hull[-2], hull[-1], x, y):
                hull.pop()
            hull.append((x, y))
        if len(window) >= 4:
            for (x0, y0), (x1, y1) in pairwise(hull):
                if x0 <= middle <= x1:
                    self._slope = max(-limit, min(limit, (y1 - y0) / (x1 - x0)))
        self._intercept_ms = min(y - self._slope * x for x, y in hull)

    def _offset_ms(self, sensor_ms: float) -> float:
        return self._intercept_ms + self._slope * sensor_ms

    def _host_ns(self, sensor_ms: float) -> int:
        # Even the least delay of a few scans is late by something: of n delays that are each spread over the
        # jitter and over the counter's millisecond, by this much on average.
        jitter_ms = self._config.jitter_ms
        excess_ms = min(math.sqrt(math.pi / 2 * jitter_ms / len(self._window)), (jitter_ms + 1.0) / 2)
        latency_ms = self._config.latency_ms + excess_ms - _QUANTUM_MS
        return self._origin_ns + round((sensor_ms + self._offset_ms(sensor_ms) - latency_ms) * 1e6)


def _turns_right(a: tuple[float, float], b: tuple[float, float], x: float, y: float) -> bool:
    """Whether `b` lies on or above the line from `a` to the point (x, y)."""
    return (b[0] - a[0]) * (y - a[1]) <= (b[1] - a[1]) * (x - a[0])


def _regular(step_ms: float) -> bool:
    """Whether two stamps are whole revolutions apart."""
    turns = round(step_ms / 100.0)
    return turns >= 1 and abs(step_ms - 100.0 * turns) <= 1.0 + 0.01 * turns * 100.0


class Sequence:
    """Counts what is missing and what comes twice, by the sensor's own stamps."""

    def __init__(self, skip: int = 0) -> None:
        self._period_ms = 100.0 * (skip + 1)
        self._last_ms: int | None = None
        self.duplicates = 0
        self.missed = 0

    def restart(self) -> None:
        """Begin anew, as after a reset of the sensor."""
        self._last_ms = None

    def fresh(self, stamp_ms: int) -> bool:
        """Take the next stamp; False for a scan that was already there."""
        last_ms, self._last_ms = self._last_ms, stamp_ms
        if last_ms is None:
            return True
        step_ms = (stamp_ms - last_ms) % STAMP_MODULUS_MS
        if step_ms == 0:
            self.duplicates += 1
            return False
        if step_ms < 600_000:  # anything else is a reset or a damaged stamp, which ClockMap judges
            self.missed += max(0, round(step_ms / self._period_ms) - 1)
        return True
