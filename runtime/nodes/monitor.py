"""Monitor process: follows every scan from the laser to the map and says how long each hop took.

It reads stamps and sequence numbers and decodes nothing, so that looking does not slow what it looks at.
The last minute is in its own diagnostics, and decides whether it warns; the whole run is in `latency.json` of
its results when it ends.
"""

import json
from dataclasses import dataclass

from runtime.latency import Journeys, Rate
from runtime.port import Port, Received

SUBSCRIBES = ("scan", "odom", "pose", "map", "map_updates")
PUBLISHES = ()

_TURN_S = 0.05
_REPORT_NS = 1_000_000_000

REASONS = {
    "scan": "the scans come late: look at the laser's line, end other programs",
    "match": "the matcher waits for the processor: end other programs",
    "map": "the mapper takes long: fewer mapper.mapping.particles, end other programs",
}
"""What is wrong and what to do, by the hop that is slow."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """When to warn."""

    late_ms: float = 200.0
    """p99 from the first ray to the pose, over the last minute, ms: a revolution and as much again."""

    def __post_init__(self) -> None:
        if not 0 < self.late_ms <= 60_000:
            raise ValueError(f"late_ms = {self.late_ms}, must be in (0, 60000]")


def run(port: Port, config: Config) -> int:
    """Follow the scans until the port closes."""
    # Everything counts here: a hop that was overwritten in the monitor would look like a scan that was lost.
    inboxes = {name: port.subscribe(name, keep=1 if name == "map" else 256, raw=True) for name in SUBSCRIBES}
    journeys = Journeys()
    rates = {name: Rate() for name in SUBSCRIBES}
    port.ready()
    due_ns = port.clock.now_ns()
    values: dict[str, str] = {}
    while not port.stopping:
        arrived: list[Received] = []
        if (first := inboxes["scan"].wait(_TURN_S)) is not None:
            arrived.append(first)
        for name in SUBSCRIBES:
            arrived += inboxes[name].drain()
        for received in sorted(arrived, key=lambda one: one.published_ns):
            journeys.see(received)
        now_ns = port.clock.now_ns()
        if now_ns >= due_ns:
            due_ns = now_ns + _REPORT_NS
            values = journeys.values(now_ns)
            for name, inbox in inboxes.items():
                values[f"{name}.rate_hz"] = f"{rates[name].update(now_ns / 1e9, inbox.received):.2f}"
            p99_ms = journeys.hops["whole"].recent.summary(now_ns).get("p99", 0.0)
            if p99_ms > config.late_ms:
                late = f"poses are late: p99 {p99_ms:.0f} ms, limit {config.late_ms:g} ms"
                port.report("warn", f"{late}; {reason(journeys, now_ns)}", **values)
            else:
                port.report("ok", used(journeys), **values)
    port.report("ok", used(journeys), **{**values, **journeys.values(port.clock.now_ns())})
    if port.results_dir is not None:
        port.results_dir.mkdir(parents=True, exist_ok=True)
        hops = {name: {"count": h.run.count, **h.run.summary()} for name, h in journeys.hops.items()}
        hops = {name: values for name, values in hops.items() if values["count"]}
        text = json.dumps({"unit": "ms", "hops": hops, **journeys.counts()}, indent=2)
        (port.results_dir / "latency.json").write_text(text + "\n", encoding="utf-8")
    return 0


def reason(journeys: Journeys, now_ns: int) -> str:
    """Return where the slow scans of the last minute lost most of their time, and what helps."""
    lost_ms = {hop: journeys.hops[hop].recent.summary(now_ns).get("p99", 0.0) for hop in REASONS}
    # A scan takes a revolution, however fast the machine is.
    lost_ms["scan"] -= journeys.hops["scan"].recent.summary(now_ns).get("p50", 0.0)
    return REASONS[max(lost_ms, key=lambda hop: lost_ms[hop])]


def used(journeys: Journeys) -> str:
    """Return how many of the scans became poses, in words."""
    late = f", {journeys.late} too late" if journeys.late else ""
    return f"used {journeys.mapped} of {journeys.scans} scans{late}"
