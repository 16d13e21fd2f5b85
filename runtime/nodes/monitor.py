"""Monitor process: follows every scan from the laser to the map and says how long each hop took.

It reads stamps and sequence numbers and decodes nothing, so that looking does not slow what it looks at.
What it measured is in its own diagnostics, and in `latency.json` of its results when it ends.
"""

import json
import time
from dataclasses import dataclass

from runtime.latency import Journeys, Rate
from runtime.port import Port, Received

SUBSCRIBES = ("scan", "odom", "pose", "map", "map_updates")
PUBLISHES = ()

_TURN_S = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """When to warn."""

    late_ms: float = 200.0
    """p99 from the first ray to the pose, over the whole run, ms: a revolution and as much again."""

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
    due = time.monotonic()
    values: dict[str, str] = {}
    while not port.stopping:
        arrived: list[Received] = []
        if (first := inboxes["scan"].wait(_TURN_S)) is not None:
            arrived.append(first)
        for name in SUBSCRIBES:
            arrived += inboxes[name].drain()
        for received in sorted(arrived, key=lambda one: one.published_ns):
            journeys.see(received)
        now = time.monotonic()
        if now >= due:
            due = now + 1.0
            values = journeys.values()
            for name, inbox in inboxes.items():
                values[f"{name}.rate_hz"] = f"{rates[name].update(now, inbox.received):.2f}"
            p99_ms = journeys.hops["whole"].quantile_ms(0.99)
            if p99_ms > config.late_ms:
                port.report(
                    "warn", f"poses are late: p99 {p99_ms:.0f} ms, limit {config.late_ms:g} ms", **values
                )
            else:
                port.report("ok", used(journeys), **values)
    port.report("ok", used(journeys), **{**values, **journeys.values()})
    if port.results_dir is not None:
        port.results_dir.mkdir(parents=True, exist_ok=True)
        hops = {hop: {"count": h.count, **h.summary()} for hop, h in journeys.hops.items() if h.count}
        counts = {
            "scans": journeys.scans,
            "matched": journeys.matched,
            "mapped": journeys.mapped,
            "late": journeys.late,
        }
        text = json.dumps({"unit": "ms", "hops": hops, **counts}, indent=2)
        (port.results_dir / "latency.json").write_text(text + "\n", encoding="utf-8")
    return 0


def used(journeys: Journeys) -> str:
    """Return how many of the scans became poses, in words."""
    late = f", {journeys.late} too late" if journeys.late else ""
    return f"used {journeys.mapped} of {journeys.scans} scans{late}"
