"""How long a scan takes from the laser to the map, hop by hop, in bounded memory.

Every message made of a scan carries that scan's stamp, and its attachment says when it was published.
Nothing is decoded for this: the stamp is in the first bytes of the payload.
"""

import math
from collections import OrderedDict
from dataclasses import dataclass, field

from runtime.messages import peek_stamp_ns
from runtime.port import Received

_BUCKET = 1.05  # relative width of a bucket: no quantile is further off
_LOWEST_MS = 1e-3
_BUCKETS = 430  # up to some 1300 s
_REMEMBERED = 256  # scans under way at a time; older ones will not be answered any more


class Histogram:
    """Counts of durations in logarithmic buckets of 5 %; the size never changes."""

    def __init__(self) -> None:
        self._counts = [0] * _BUCKETS
        self.count = 0
        self.max_ms = 0.0

    def add(self, duration_ms: float) -> None:
        """Take a duration in; a negative one counts as none."""
        bucket = 0
        if duration_ms > _LOWEST_MS:
            bucket = min(_BUCKETS - 1, 1 + int(math.log(duration_ms / _LOWEST_MS) / math.log(_BUCKET)))
        self._counts[bucket] += 1
        self.count += 1
        self.max_ms = max(self.max_ms, duration_ms)

    def quantile_ms(self, share: float) -> float:
        """Return the duration that `share` in (0, 1] of all do not exceed, to 5 %; NaN if there are none."""
        if not self.count:
            return math.nan
        rank, seen = math.ceil(share * self.count), 0
        for bucket, count in enumerate(self._counts):
            seen += count
            if seen >= rank:
                return min(self.max_ms, _LOWEST_MS * _BUCKET**bucket)
        return self.max_ms

    def values(self, hop: str) -> dict[str, str]:
        """Return the summary as the diagnostics carry it: `latency.match.p99_ms` and the like."""
        return {f"latency.{hop}.{name}_ms": f"{value:.2f}" for name, value in self.summary().items()}

    def summary(self) -> dict[str, float]:
        """Return p50, p99 and max in ms."""
        return {"p50": self.quantile_ms(0.5), "p99": self.quantile_ms(0.99), "max": self.max_ms}


SCREEN = "screen"
HOPS = {
    "scan": "first ray to scan published: one revolution, the serial line, the driver",
    "match": "scan published to odom published",
    "map": "odom published to pose published",
    "whole": "first ray to pose published",
    "grid": "last scan in it to map published",
    SCREEN: "first ray to picture drawn, in the viewer's process",
}


@dataclass(slots=True)
class _Passage:
    """When what was made of one scan was published; 0 for not yet."""

    scan_ns: int = 0
    odom_ns: int = 0
    mapped: bool = False


@dataclass(slots=True)
class Journeys:
    """Follows every scan through the topics; feed it raw messages as they come."""

    hops: dict[str, Histogram] = field(
        default_factory=lambda: {hop: Histogram() for hop in HOPS if hop != SCREEN}
    )
    scans: int = 0
    matched: int = 0
    mapped: int = 0
    late: int = 0
    """Scans that got no pose although a later one did: skipped, because a newer one was there already."""
    _under_way: OrderedDict[int, _Passage] = field(default_factory=OrderedDict)

    def see(self, received: Received) -> None:
        """Take note of a message on `scan`, `odom`, `pose`, `map` or `map_updates`."""
        stamp_ns = peek_stamp_ns(received.payload)
        if stamp_ns is None or not received.published_ns:
            return
        published_ns = received.published_ns
        if received.topic in ("map", "map_updates"):
            self._add("grid", published_ns - stamp_ns)
            return
        passage = self._under_way.get(stamp_ns)
        if passage is None:
            passage = self._under_way[stamp_ns] = _Passage()
            if len(self._under_way) > _REMEMBERED:
                self._under_way.popitem(last=False)
        if received.topic == "scan":
            self.scans += 1
            passage.scan_ns = published_ns
            self._add("scan", published_ns - stamp_ns)
        elif received.topic == "odom":
            self.matched += 1
            passage.odom_ns = published_ns
            if passage.scan_ns:
                self._add("match", published_ns - passage.scan_ns)
        elif received.topic == "pose":
            self.mapped += 1
            passage.mapped = True
            self._add("whole", published_ns - stamp_ns)
            if passage.odom_ns:
                self._add("map", published_ns - passage.odom_ns)
            self._leave_behind(stamp_ns)

    def _leave_behind(self, stamp_ns: int) -> None:
        """Count what was overtaken, and forget it."""
        overtaken = [stamp for stamp in self._under_way if stamp <= stamp_ns]
        for stamp in overtaken:
            passage = self._under_way.pop(stamp)
            self.late += bool(passage.scan_ns and not passage.mapped)

    def _add(self, hop: str, duration_ns: int) -> None:
        self.hops[hop].add(duration_ns / 1e6)

    def values(self) -> dict[str, str]:
        """Return everything measured as the diagnostics carry it."""
        values: dict[str, str] = {}
        for hop, histogram in self.hops.items():
            if histogram.count:
                values |= histogram.values(hop)
        counts = {"scans": self.scans, "matched": self.matched, "mapped": self.mapped, "late": self.late}
        return values | {name: str(count) for name, count in counts.items()}


class Rate:
    """Messages per second over the last few seconds."""

    _SPAN_S = 5.0

    def __init__(self) -> None:
        self._marks: list[tuple[float, int]] = []

    def update(self, now_s: float, count: int) -> float:
        """Take a running count; return its rate, Hz."""
        self._marks.append((now_s, count))
        while len(self._marks) > 2 and self._marks[1][0] < now_s - self._SPAN_S:
            self._marks.pop(0)
        (then_s, before), (now_s, after) = self._marks[0], self._marks[-1]
        return (after - before) / (now_s - then_s) if now_s > then_s else 0.0
