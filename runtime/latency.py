"""How long a scan takes from the laser to the map, hop by hop, in bounded memory.

Every message made of a scan carries that scan's stamp, and its attachment says when it was published.
Nothing is decoded for this: the stamp is in the first bytes of the payload.

Two memories of the same durations: the whole run's is for its report, the last minute's for whoever wants to
know how the robot is now. A slow start is in the first one for ever, and in the second for a minute.
"""

import math
import threading
from collections import OrderedDict, deque
from dataclasses import dataclass, field

from runtime.messages import peek_stamp_ns
from runtime.port import Received

BUCKET = 1.05
"""Ratio of the two edges of a bucket."""
_LOWEST_MS = 1e-3
_BUCKETS = 430  # up to some 1200 s
_REMEMBERED = 256  # scans under way at a time; older ones will not be answered any more
RECENT_NS = 60_000_000_000
_RECENT = 4096  # durations: a minute of the fastest laser that we know, 40 Hz, and half as much again


class Histogram:
    """Counts of durations in logarithmic buckets; the size never changes.

    The idea of HdrHistogram: as many buckets a decade whatever the decade, so that memory is bounded and the
    error is relative. Between 1 us and 1200 s a quantile is never below the exact one and at most 5 % above
    it; outside it is the nearest of these, or the largest duration. `hdrhistogram` on PyPI counts as fast and
    would be right to 0.1 %, which no limit of ours asks for, and brings `pbr` and `setuptools` to the robot.
    """

    def __init__(self) -> None:
        self._counts = [0] * _BUCKETS
        self.count = 0
        self.max_ms = 0.0

    def add(self, duration_ms: float) -> None:
        """Take a duration in; a negative one counts as none."""
        bucket = 0
        if duration_ms > _LOWEST_MS:
            bucket = min(_BUCKETS - 1, 1 + int(math.log(duration_ms / _LOWEST_MS) / math.log(BUCKET)))
        self._counts[bucket] += 1
        self.count += 1
        self.max_ms = max(self.max_ms, duration_ms)

    def quantile_ms(self, share: float) -> float:
        """Return the duration that `share` in (0, 1] of all do not exceed, or up to 5 % more; NaN of none."""
        if not self.count:
            return math.nan
        rank, seen = math.ceil(share * self.count), 0
        for bucket, count in enumerate(self._counts[:-1]):
            seen += count
            if seen >= rank:
                return min(self.max_ms, _LOWEST_MS * BUCKET**bucket)
        return self.max_ms

    def summary(self) -> dict[str, float]:
        """Return p50, p99 and max in ms."""
        return {"p50": self.quantile_ms(0.5), "p99": self.quantile_ms(0.99), "max": self.max_ms}


class Recent:
    """The durations of the last minute, of which quantiles are exact; any thread may add, any may read.

    At more than 68 a second it is less than a minute: only so many are remembered.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._durations: deque[tuple[int, float]] = deque(maxlen=_RECENT)

    def add(self, duration_ms: float, now_ns: int) -> None:
        """Take a duration in at its time."""
        with self._lock:
            self._durations.append((now_ns, duration_ms))

    def summary(self, now_ns: int) -> dict[str, float]:
        """Return p50, p99 and max in ms; nothing if there was none."""
        with self._lock:
            while self._durations and self._durations[0][0] <= now_ns - RECENT_NS:
                self._durations.popleft()
            ordered = sorted(duration_ms for _, duration_ms in self._durations)
        if not ordered:
            return {}
        shares = {"p50": 0.5, "p99": 0.99, "max": 1.0}
        return {name: ordered[math.ceil(share * len(ordered)) - 1] for name, share in shares.items()}


@dataclass(frozen=True, slots=True)
class Hop:
    """How long one part of the way takes: over the whole run, and now."""

    run: Histogram = field(default_factory=Histogram)
    recent: Recent = field(default_factory=Recent)

    def add(self, duration_ms: float, now_ns: int) -> None:
        """Take a duration in at its time."""
        self.run.add(duration_ms)
        self.recent.add(duration_ms, now_ns)

    def values(self, name: str, now_ns: int) -> dict[str, str]:
        """Return the last minute as the diagnostics carry it: `latency.match.p99_ms` and the like."""
        return {f"latency.{name}.{q}_ms": f"{ms:.2f}" for q, ms in self.recent.summary(now_ns).items()}


SCREEN = "screen"
HOPS = {
    "scan": "first ray to scan published: one revolution, the serial line, the driver",
    "match": "scan published to odom published",
    "map": "odom published to pose published",
    "whole": "first ray to pose published",
    "grid": "last scan in it to map published",
    SCREEN: "first ray to picture drawn: in the viewer's process",
}
"""From where to where each hop is, and behind a colon what is in it."""


@dataclass(slots=True)
class _Passage:
    """When what was made of one scan was published; 0 for not yet."""

    scan_ns: int = 0
    odom_ns: int = 0
    mapped: bool = False


@dataclass(slots=True)
class Journeys:
    """Follows every scan through the topics; feed it raw messages as they come."""

    hops: dict[str, Hop] = field(default_factory=lambda: {hop: Hop() for hop in HOPS if hop != SCREEN})
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
            self._add("grid", stamp_ns, received)
            return
        passage = self._under_way.get(stamp_ns)
        if passage is None:
            passage = self._under_way[stamp_ns] = _Passage()
            if len(self._under_way) > _REMEMBERED:
                self._under_way.popitem(last=False)
        if received.topic == "scan":
            self.scans += 1
            passage.scan_ns = published_ns
            self._add("scan", stamp_ns, received)
        elif received.topic == "odom":
            self.matched += 1
            passage.odom_ns = published_ns
            if passage.scan_ns:
                self._add("match", passage.scan_ns, received)
        elif received.topic == "pose":
            self.mapped += 1
            passage.mapped = True
            self._add("whole", stamp_ns, received)
            if passage.odom_ns:
                self._add("map", passage.odom_ns, received)
            self._leave_behind(stamp_ns)

    def _leave_behind(self, stamp_ns: int) -> None:
        """Count what was overtaken, and forget it."""
        overtaken = [stamp for stamp in self._under_way if stamp <= stamp_ns]
        for stamp in overtaken:
            passage = self._under_way.pop(stamp)
            self.late += bool(passage.scan_ns and not passage.mapped)

    def _add(self, hop: str, since_ns: int, received: Received) -> None:
        self.hops[hop].add((received.published_ns - since_ns) / 1e6, received.received_ns)

    def counts(self) -> dict[str, int]:
        """Return how many scans came how far, over the whole run."""
        return {"scans": self.scans, "matched": self.matched, "mapped": self.mapped, "late": self.late}

    def values(self, now_ns: int) -> dict[str, str]:
        """Return the hops of the last minute, and the counts, as the diagnostics carry them."""
        values: dict[str, str] = {}
        for name, hop in self.hops.items():
            values |= hop.values(name, now_ns)
        return values | {name: str(count) for name, count in self.counts().items()}


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
